"""Judging a run: comparison, report, and what the report tells about the run."""

import json
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from orchestrator import System, Trace, assemble, load, run
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording
from orchestrator.results.layout import Layout
from orchestrator.results.validate_system import describe, judge, parameters

PROVENANCE = '[parameters.factor]\nvalue = 1.0\nunit = "1"\nsource = "assumed"\nnote = "a free choice"\n'


@pytest.fixture
def ramp() -> Trace:
    """The input of the gain: 0 to 4 m in 1 s."""
    return Trace(np.array([0.0, 1.0]), {"u": np.array([0.0, 4.0])})


@pytest.fixture
def reference() -> Recording:
    """What the gain should do, in mm: y = 2 u."""
    t = np.linspace(0, 1, 11)
    criteria = {"gain.y": Criterion("Out", "out", tolerance=Tolerance("nrmse", 0.01))}
    known = {"title": "Gain", "criteria": criteria, "metadata": {"title": "Gain", "kind": "measurement"}}
    return Recording(t, {"gain.y": 8e3 * t}, {"gain.y": "mm"}, Path("ref.csv"), **known)


def judged(fmu, ramp, reference, out, factor=2.0):
    """Run the gain and judge it; returns the validation and the report's data."""
    result = run(str(fmu), ramp, step=0.1, set={"gain.factor": factor})
    facts = {"system": "gain.fmu", "steps asked for": 10}
    validation, _, html, data = judge(result, reference, Layout(), out, facts)
    assert html.read_text(encoding="utf-8").startswith("<!")
    return validation, json.loads(data.read_text(encoding="utf-8"))


def test_a_run_within_its_limits_and_one_that_misses_them(fmus, ramp, reference, tmp_path):
    """The folder is made, both files are in it, and they tell what ran; also where a limit is missed."""
    validation, data = judged(fmus["gain"], ramp, reference, tmp_path / "new" / "folder")
    assert validation.passed
    assert validation["gain.y"].metrics.maximum_error < 1e-12  # straight lines, a few roundings of 8 m
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == ["report.html", "report.json"]
    assert data["title"] == "Validation of gain"
    assert data["passed"]
    assert data["facts"] == {"system": "gain.fmu", "steps asked for": 10}
    assert data["accuracy"]["steps"] == 10
    assert [(c["name"], c["file"], c["guid"]) for c in data["components"]] == [("gain", "gain.fmu", "gain")]
    validation, data = judged(fmus["gain"], ramp, reference, tmp_path, factor=2.1)
    assert not validation.passed
    assert not data["passed"]
    # the error is 5 % of a ramp from 0 to 8 m: 0.05 times the root mean square of 0, 0.1 ... 1
    assert data["signals"][0]["metrics"]["nrmse"] == pytest.approx(0.05 * np.sqrt(0.35), rel=1e-9)


def test_parameters_tell_their_source_where_the_fmu_knows_it(fmus):
    """Value of this run, unit, source and note, and whether it was set for this run."""
    fmu = fmus.make("gain", "known", extra={"resources/parameters.toml": PROVENANCE})
    system = load(fmu).with_start({"known.offset": 0.5})
    found = {p["name"]: p for p in parameters(system)}
    factor, offset = found["factor"], found["offset"]
    assert (factor["value"], factor["source"], factor["note"]) == (1.0, "assumed", "a free choice")
    assert (offset["value"], offset["unit"], offset["source"]) == (0.5, "m", "")
    assert (factor["changed"], offset["changed"]) == (False, True)


@pytest.mark.parametrize("text", ["x = ", "parameters = 3", "[parameters.other]\nvalue = 1\n", "\udcff"])
def test_another_file_of_that_name_does_no_harm(fmus, text):
    """FMUs from elsewhere may carry anything under resources/parameters.toml."""
    content = text.encode("utf-8", "surrogateescape")
    fmu = fmus.make("gain", "other", extra={"resources/parameters.toml": content})
    assert [(p["name"], p["source"]) for p in parameters(load(fmu))] == [("factor", ""), ("offset", "")]


def test_the_machine_is_described_by_its_files(system):
    """Every parameter has its source and note; of each component the place in the SSP, and its GUID."""
    found = list(parameters(system))
    assert {p["component"] for p in found} == set(system.components)
    assert all(p["source"] and p["note"] and p["text"] for p in found)
    for name, component in system.components.items():
        told = describe(component)
        assert told["file"] == f"resources/{name}.fmu"
        assert told["guid"] == component.interface.model.token != ""
        assert told["version"] == version("harvester-cosim")
        assert told["tool"].startswith("harvester-cosim ")
        assert told["text"]


def test_a_system_in_memory_can_be_judged(fmus, reference, tmp_path):
    """Also one of two components, without a scenario."""
    system: System = assemble({"s": fmus["source"], "gain": fmus["gain"]}, ["s.y -> gain.u"])
    result = run(system, step=0.1, stop=1.0)
    validation, *_ = judge(result, reference, Layout(), tmp_path, {})
    assert [row.signal for row in validation.failed] == ["gain.y"]
