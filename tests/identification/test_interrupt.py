"""Ctrl-C while `harvester identify` works: what was found until then is written."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmus.identification import command, pipeline
from fmus.identification.estimate import Estimate
from fmus.identification.machine import nominal
from fmus.identification.pipeline import identify
from fmus.identification.procedure_result import ProcedureResult
from fmus.identification.refinement.multistart import MultistartResult
from fmus.identification.refinement.refine import RefinementResult
from orchestrator.__main__ import main
from orchestrator.data.recording import Recording

VALVE = Recording(Path("valve.csv"), np.arange(9.0), {}, {}, procedure="valve")
MACHINE = replace(VALVE, source=Path("machine.csv"), procedure="machine")
AREA = Estimate("valve_area", 2e-5, "m2", 1e-7, 1.98e-5, 2.02e-5, "by hand")


class Procedure:
    """Finds one parameter, or is interrupted."""

    SIGNALS = ()

    def __init__(self, interrupted: bool) -> None:
        self.interrupted = interrupted

    def identify(self, *_: object) -> ProcedureResult:
        """The valve."""
        if self.interrupted:
            raise KeyboardInterrupt
        return ProcedureResult("valve", "Valve", 5, (AREA,), ())


def interrupt(*_: object, **__: object) -> None:
    """Whatever was to be done."""
    raise KeyboardInterrupt


@pytest.fixture
def quick(monkeypatch):
    """Only a valve, found at once."""
    monkeypatch.setattr(pipeline, "PROCEDURES", {"valve": Procedure(False)})
    return monkeypatch


def test_a_finished_procedure_is_kept(quick):
    """An interrupt in the joint refinement, before there is any point to keep, leaves the valve."""
    quick.setattr(pipeline, "refine_together", interrupt)
    found = identify([VALVE, MACHINE])
    assert found.interrupted
    assert list(found.estimates) == ["valve_area"]
    assert found.parameters["swing.valve_area"].value == AREA.value
    assert identify([VALVE]).interrupted is False


def test_nothing_found_is_an_interrupt(quick):
    """There is nothing to write, and an earlier file stays as it is."""
    quick.setattr(pipeline, "PROCEDURES", {"valve": Procedure(True)})
    with pytest.raises(KeyboardInterrupt):
        identify([VALVE])


def test_an_interrupted_search_is_not_begun_again(quick):
    """The best point so far is kept; random starts are not gone through one interrupt after the other."""

    class Best:
        reason = "interrupted"

        def estimates(self, **_: object) -> tuple[Estimate, ...]:
            return (replace(AREA, value=3e-5),)

    quick.setattr(pipeline, "refine_together", lambda *_: Best())
    quick.setattr(pipeline, "refine_from_other_starts", lambda *_: pytest.fail("begun again"))
    found = identify([VALVE, MACHINE], starts=4)
    assert found.interrupted
    assert found.parameters["swing.valve_area"].value == 3e-5


def test_interrupted_starts_keep_the_result(quick):
    """The refinement was done; the starts that were compared are told."""
    refined = RefinementResult.__new__(RefinementResult)
    object.__setattr__(refined, "reason", "converged")
    quick.setattr(RefinementResult, "estimates", lambda *_, **__: (AREA,))
    quick.setattr(pipeline, "refine_together", lambda *_: refined)
    quick.setattr(pipeline, "multistart", lambda *_, **__: MultistartResult((), 0.0, {}, interrupted=True))
    found = identify([VALVE, MACHINE], starts=4)
    assert found.interrupted
    assert found.refined is refined


def test_the_command_writes_what_it_has(quick, tmp_path, capsys):
    """parameters.toml of what was found, one line about it, exit status 130 as in other commands."""
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
