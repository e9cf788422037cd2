"""docs/recordings.md shows what can be read."""

import re
from pathlib import Path

from fmus.identification.recordings import meta, signals
from fmus.identification.recordings.reading import read

TEXT = (Path(__file__).parents[3] / "docs" / "recordings.md").read_text(encoding="utf-8")


def test_the_example_of_the_docs_is_read(tmp_path):
    """The meta file in the text, beside the columns that it names."""
    (example,) = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    (tmp_path / "valve_pa.toml").write_text(example, encoding="utf-8")
    (tmp_path / "valve_pa.csv").write_text("t,U,P1,P2,Q\n0,1,2,3,4\n5,1,2,3,4\n", encoding="utf-8")
    found = read(tmp_path / "valve_pa.csv")
    assert list(found.signals) == ["command", "pressure_in", "pressure_out", "flow"]
    assert (found.procedure, dict(found.conditions)) == ("valve", {"edge": "P-A"})


def test_every_procedure_and_function_of_the_docs_exists():
    """Procedures, keys of a signal and functions that the text names are those of the code."""
    assert all(f"`{name}`" in TEXT for name in meta.PROCEDURES)
    for cells in re.findall(r"^\| (`[a-z_A-Z`, ]+) \| ", TEXT[TEXT.index("## Signals") :], re.MULTILINE):
        assert all(hasattr(signals, name) for name in re.findall(r"`(\w+)`", cells))
