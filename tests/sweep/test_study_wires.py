"""Inputs that a wire feeds: a study is told what it can do instead, and that works."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator import Problem
from orchestrator.studies.cases import resolve
from orchestrator.studies.study import read

STUDY = """
system = "{system}"
method = "latin"
runs = 2
stop = 0.1

[factors]
"{factor}" = {{ distribution = "uniform", minimum = 1, maximum = 2 }}

[outputs]
peak = {{ signal = "swing.swing_pressure_a", measure = "maximum" }}
"""


def _file(folder: Path, fmus: Path, factor: str) -> Path:
    file = folder / "study.toml"
    text = STUDY.format(system=(fmus / "harvester.ssp").as_posix(), factor=factor)
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize("name", ["boom_command", "boom_stick.boom_command"])
def test_a_wired_input_is_refused_with_what_a_study_can_do(name: str, fmu_dir: Path, tmp_path: Path) -> None:
    """In one line, and without --cut, which `sweep` has not got."""
    file = _file(tmp_path, fmu_dir, name)
    with pytest.raises(Problem) as wrong:
        resolve(read(file))[0]
    key = f'"{name}"' if "." in name else name
    wire = "operator_input.boom_command -> boom_stick.boom_command"
    assert str(wrong.value) == (
        f"{file}: factors.{key}: {name}: expected an unconnected input, got the connection {wire};"
        " vary parameters of operator_input, or drive boom_stick.boom_command by a scenario under choices"
    )


def test_what_the_refusal_advises_is_accepted(fmu_dir: Path, tmp_path: Path) -> None:
    """A parameter of operator_input can be a factor; a scenario can drive the connected input itself."""
    assert resolve(read(_file(tmp_path, fmu_dir, "operator_input.boom_1_command")))[0].factors
    file = _file(tmp_path, fmu_dir, "manipulator.head_mass")
    (tmp_path / "rest.csv").write_text("time,boom_stick.boom_command\n0,0\n", encoding="utf-8")
    file.write_text(file.read_text("utf-8") + '[choices]\nscenario = "rest.csv"\n', encoding="utf-8")
    assert resolve(read(file))[0].fixed_choices[0].options == ("rest.csv",)
