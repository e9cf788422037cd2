"""Ctrl-C during `harvester identify`: the estimates until then are written."""

import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from fmus.identification import command, pipeline
from fmus.identification.machine import nominal
from fmus.identification.pipeline import identify
from fmus.identification.results import Estimate, ProcedureResult
from orchestrator.__main__ import main
from orchestrator.data.recording import Recording

VALVE = Recording(Path("valve.csv"), np.arange(9.0), {}, {}, procedure="valve")
MACHINE = replace(VALVE, source=Path("machine.csv"), procedure="machine")
AREA = Estimate("valve_area", 2e-5, "m2", 1e-7, 1.98e-5, 2.02e-5, "by hand")
WITHOUT_ZEROS = SimpleNamespace(outputs=())


class Procedure:
    """Estimates one parameter, or is interrupted."""

    SIGNALS: ClassVar[dict[str, str]] = {}

    def __init__(self, interrupted: bool) -> None:
        self.interrupted = interrupted

    def identify(self, *_: object) -> ProcedureResult:
        """The valve."""
        if self.interrupted:
            raise KeyboardInterrupt
        return ProcedureResult("valve", "Valve", 5, (AREA,), ())


def interrupt(*_: object, **__: object) -> None:
    """Any function, interrupted."""
    raise KeyboardInterrupt


@pytest.fixture
def quick(monkeypatch):
    """Only the valve, estimated without computation."""
    monkeypatch.setattr(pipeline, "PROCEDURES", {"valve": Procedure(False)})
    return monkeypatch


def test_a_finished_procedure_is_kept(quick):
    """An interrupt in the joint refinement, before its first iteration, leaves the valve."""
    quick.setattr(pipeline, "refine_together", interrupt)
    found = identify([VALVE, MACHINE])
    assert found.interrupted
    assert list(found.estimates) == ["valve_area"]
    assert found.parameters["swing.valve_area"].value == AREA.value
    assert identify([VALVE]).interrupted is False


def test_an_interrupt_without_estimates_is_raised(quick):
    """Nothing is written, and an earlier file does not change."""
    quick.setattr(pipeline, "PROCEDURES", {"valve": Procedure(True)})
    with pytest.raises(KeyboardInterrupt):
        identify([VALVE])


def test_an_interrupted_search_is_not_restarted(quick):
    """The best point so far is kept, and the random starts are skipped."""
    better = (replace(AREA, value=3e-5),)
    best = SimpleNamespace(reason="interrupted", problem=WITHOUT_ZEROS, estimates=lambda: better)
    quick.setattr(pipeline, "refine_together", lambda *_: best)
    quick.setattr(pipeline, "multistart", lambda *_: pytest.fail("restarted"))
    found = identify([VALVE, MACHINE], starts=4)
    assert found.interrupted
    assert found.parameters["swing.valve_area"].value == 3e-5


def test_interrupted_starts_keep_the_result(quick):
    """The result of the refinement is kept."""
    refined = SimpleNamespace(reason="converged", problem=WITHOUT_ZEROS, estimates=lambda: (AREA,))
    quick.setattr(pipeline, "refine_together", lambda *_: refined)
    quick.setattr(pipeline, "multistart", interrupt)
    found = identify([VALVE, MACHINE], starts=4)
    assert found.interrupted
    assert found.refined is refined


def test_the_command_writes_what_it_has(quick, tmp_path, capsys):
    """parameters.toml with the estimates, one line about it, exit status 130 as in other commands."""
    quick.chdir(tmp_path)
    quick.setattr(pipeline, "refine_together", interrupt)
    for name, value in {
        "read_folder": lambda _: [VALVE, MACHINE],
        "quality": lambda _: None,
        "faults": lambda _: [],
        "unused_files": lambda *_: [],
        "resample_uniformly": lambda r: r,
        "downsample": lambda r: r,
    }.items():
        quick.setattr(command, name, value)
    assert main(["identify", "mine"]) == 130
    out, err = capsys.readouterr()
    assert err == "harvester: interrupted\n"
    assert out.splitlines()[-1] == "parameters.toml: 1 parameter, estimated until the interrupt; no report"
    table = tomllib.loads(Path("parameters.toml").read_text(encoding="utf-8"))["parameters"]["valve_area"]
    assert (table["value"], table["unit"]) == (AREA.value, nominal()["swing.valve_area"].unit)
    assert not Path("build/identification.html").exists()
