"""Ctrl-C during `harvester identify`: the estimates until then are written."""

import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fmus.identification import pipeline
from fmus.identification.machine import nominal
from fmus.identification.pipeline import identify
from fmus.identification.recordings import reading
from fmus.identification.report import identification_page
from fmus.identification.results import Estimate, ProcedureResult
from orchestrator.__main__ import main
from orchestrator.data.recording import Recording

VALVE = Recording(np.arange(9.0), {}, {}, Path("valve.csv"), procedure="valve")
MACHINE = replace(VALVE, source=Path("machine.csv"), procedure="machine")
AREA = Estimate("valve_area", 2e-5, "m2", 1e-7, 1.98e-5, 2.02e-5, "by hand")
WITHOUT_ZEROS = SimpleNamespace(outputs=())


def interrupt(*_: object, **__: object) -> None:
    """Any function, interrupted."""
    raise KeyboardInterrupt


@pytest.fixture
def quick(monkeypatch):
    """Only the valve, estimated without computation."""
    found = ProcedureResult("valve", "Valve", 5, (AREA,), ())
    procedure = SimpleNamespace(signals={}, identify=lambda *_: found)
    monkeypatch.setattr(pipeline, "PROCEDURES", {"valve": procedure})
    return monkeypatch


def searched(reason):
    """A joint refinement that ended for a reason, with another area."""
    better = (replace(AREA, value=3e-5),)
    return lambda *_: SimpleNamespace(reason=reason, problem=WITHOUT_ZEROS, estimates=lambda: better)


@pytest.mark.parametrize(
    ("refine", "area"),
    [
        (interrupt, AREA.value),  # before its first iteration: the valve is left
        (searched("interrupted"), 3e-5),
    ],
)
def test_an_interrupt_keeps_what_is_finished(quick, refine, area):
    """In the joint refinement the results of the procedures, or its best point so far."""
    quick.setattr(pipeline, "refine_together", refine)
    found = identify([VALVE, MACHINE])
    assert found.interrupted
    assert list(found.estimates) == ["valve_area"]
    assert found.parameters["swing.valve_area"].value == area
    assert (found.refined is None) == (refine is interrupt)
    assert identify([VALVE]).interrupted is False


def test_an_interrupt_without_estimates_is_raised(quick):
    """Nothing is written, and an earlier file does not change."""
    quick.setattr(pipeline.PROCEDURES["valve"], "identify", interrupt)
    with pytest.raises(KeyboardInterrupt):
        identify([VALVE])


def test_the_command_writes_what_it_has(quick, tmp_path, capsys):
    """parameters.toml with the estimates, one line about it, exit status 130 as in other commands."""
    quick.chdir(tmp_path)
    quick.setattr(pipeline, "refine_together", interrupt)
    quick.setattr(pipeline, "prepared", lambda r: (r, None))
    quick.setattr(identification_page, "faults", lambda _: [])
    quick.setattr(reading, "read_folder", lambda _: [VALVE, MACHINE])
    quick.setattr(reading, "unused_files", lambda *_: [])
    Path("mine").mkdir()
    assert main(["identify", "mine"]) == 130
    out, err = capsys.readouterr()
    assert err == "harvester: interrupted\n"
    assert out.splitlines()[-1] == "parameters.toml: 1 parameter, estimated until the interrupt; no report"
    table = tomllib.loads(Path("parameters.toml").read_text(encoding="utf-8"))["parameters"]["valve_area"]
    assert (table["value"], table["unit"]) == (AREA.value, nominal()["swing.valve_area"].unit)
    assert not Path("build/identification.html").exists()
