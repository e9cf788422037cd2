"""The examples and tables of docs/recordings.md agree with the code."""

import re
from dataclasses import fields
from pathlib import Path

from fmus.identification.machine import signal_names as names
from fmus.identification.pipeline import PROCEDURES
from fmus.identification.procedures import momentum_balance
from fmus.identification.recordings.reading import CONDITIONS, MACHINE_SIGNALS, read
from orchestrator.data.description import Origin, SignalDescription, TimeDescription

TEXT = (Path(__file__).parents[3] / "docs" / "recordings.md").read_text(encoding="utf-8")


def test_the_example_of_the_docs_is_read(tmp_path):
    """The description in the text is read with the columns that it names."""
    (example,) = (t for t in re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL) if "[experiment]" in t)
    (tmp_path / "valve_pa.toml").write_text(example, encoding="utf-8")
    (tmp_path / "valve_pa.csv").write_text("t,U,P1,P2,Q\n0,1,2,3,4\n5,1,2,3,4\n", encoding="utf-8")
    found = read(tmp_path / "valve_pa.csv")
    assert list(found.signals) == ["command", "pressure_in", "pressure_out", "flow"]
    assert (found.procedure, dict(found.conditions)) == ("valve", {"edge": "P-A"})


def test_every_procedure_and_key_is_in_the_docs():
    """All procedures are in the text, and all keys that a description may have in its table."""
    assert all(f"`{name}`" in TEXT for name in CONDITIONS)
    keys = TEXT[TEXT.index("## Keys") : TEXT.index("## Data files")]
    tables = (SignalDescription, TimeDescription, Origin)
    names = [f.name for table in tables for f in fields(table)]
    assert [n for n in (*names, "csv", "delimiter", "decimal", "skip_lines") if f"`{n}`" not in keys] == []


def test_the_table_of_experiments_is_that_of_the_code():
    """Each row lists the signals and conditions of the procedure; the signals of the machine exist."""
    rows = dict(re.findall(r"^\|`(\w+)`\|(.*)\|$", TEXT[TEXT.index("## Experiments") :], re.MULTILINE))
    for procedure, conditions in CONDITIONS.items():
        same = ("length", "diameter", "density", "viscosity")  # as for the hose's resistance
        assert all(name in rows[procedure] for name in conditions if name not in same)
        if procedure not in MACHINE_SIGNALS:
            assert all(f"`{name}`" in rows[procedure] for name in PROCEDURES[procedure].signals)
    # limits are of the machine's outputs, no experiment
    before, _, after = TEXT.partition("### Limits of the work cycle")
    text = before + after.partition("\n## ")[2]
    mentioned = set(re.findall(r"`((?:swing|boom_stick|manipulator)\.\w+)`", text))
    assert mentioned - set(names().values()) <= {"manipulator.boom_angel"}
    assert set(momentum_balance.SIGNALS) <= mentioned
