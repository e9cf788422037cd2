"""From edges that are no straight lines to tables that the machine reads, by the command line."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kit.mistakes import problem

from benchmarks import openings as bench
from fmus.components import opening_curve
from fmus.identification import pipeline
from fmus.identification.machine import nominal
from fmus.identification.pipeline import identify
from fmus.machine.build import harvester_machine
from fmus.parameters import values
from orchestrator import Trace, write_trace
from orchestrator.__main__ import main
from orchestrator.base.errors import Problem
from orchestrator.data.description import Description, SignalDescription, write_description

VALVE = "asymmetric 1"
UNITS = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """The files of `harvester identify` for one valve, and its exit status."""
    folder = tmp_path_factory.mktemp("valve")
    (folder / "mine").mkdir()
    for recording in bench.recordings(VALVE, 1):
        _write(folder / "mine" / f"{recording.conditions['edge']}.csv", recording)
    out = folder / "parameters.toml"
    return main(["identify", str(folder / "mine"), "--out", str(out), "--report", str(folder)]), out


def _write(path: Path, recording) -> None:
    """A recording with the description of its instruments."""
    write_trace(Trace(recording.time, recording.signals), path)
    signals = {name: SignalDescription(unit) for name, unit in UNITS.items()}
    for name, s in recording.sensors.items():
        known = {key: getattr(s, key) for key in ("noise", "resolution", "dead_zone")}
        span = (s.low, s.high)
        signals[name] = SignalDescription(UNITS[name], span=span, zero_error=s.zero_error or 0.0, **known)
    described = Description(signals, experiment={"procedure": "valve", **recording.conditions})
    write_description(path.with_suffix(".toml"), described)


def test_file_and_report_have_lists_with_their_intervals(identified):
    """All four edges, with both ends of the intervals in the JSON file, drawn on the page; exit status 0."""
    status, out = identified
    assert status == 0
    tables = tomllib.loads(out.read_text(encoding="utf-8"))["parameters"]
    for edge in ("pa", "at", "pb", "bt"):
        commands, openings = tables[f"valve_{edge}_commands"], tables[f"valve_{edge}_openings"]
        assert len(commands["value"]) == len(openings["value"]) == len(openings["sd"])
        assert commands["source"] == "identified"
    # an edge that was not on the bench has the table of the other edge of its direction
    assert tables["valve_bt_openings"]["value"] == tables["valve_pa_openings"]["value"]
    assert tables["valve_at_openings"]["value"] != tables["valve_pa_openings"]["value"]

    told = json.loads((out.parent / "identification.json").read_text(encoding="utf-8"))
    openings = [e for e in told["results"][0]["listed"] if e["unit"] == "1" and e["sd"]]
    assert len(openings) >= 12
    assert all(e["low"] < e["value"] < e["high"] for e in openings)
    assert "Tables of the openings" in (out.parent / "identification.html").read_text(encoding="utf-8")


def test_a_straight_line_empties_the_tables_of_before():
    """Known tables do not stay when a line is found to suffice."""
    known = nominal()
    table = {
        f"{part}.valve_pa_{kind}_{k}": value
        for part in ("swing", "boom_stick")
        for kind, values_of in (("command", (1.0, 10.0)), ("opening", (0.0, 1.0)))
        for k, value in enumerate(values_of, 1)
    }
    known |= {name: replace(known[name], value=value) for name, value in table.items()}
    found = identify(bench.recordings("line^1", 0), parameters=known | bench.KNOWN, joint=False)
    assert all(found.parameters[name].value == 0 for name in table)


def test_a_dead_band_behind_tables_is_not_refined(monkeypatch):
    """All edges have known tables: the joint refinement leaves out what has no effect, and says so."""
    known = {
        name: replace(number, value=10.0) if name.endswith("_command_2") else number
        for name, number in nominal().items()
    }
    asked, told = [], []

    def refine(_recordings, _parameters, names, *_):
        asked.extend(names)
        raise Problem("enough")

    monkeypatch.setattr(pipeline, "refine_together", refine)
    driven = replace(bench.recordings("line^1", 0)[0], procedure="machine", conditions={}, signals={})
    problem(lambda: identify([driven], parameters=known, report=told.append), "enough")
    assert "valve_area" in asked
    assert "valve_dead_band" not in asked
    assert any(line.startswith("valve_dead_band: not refined") for line in told)


@pytest.mark.parametrize(("edge", "name"), [("P-A", "pa"), ("P-B", "pb")])
def test_the_machine_opens_as_the_valve_does(identified, edge, name):
    """The component of the drives, with the numbers of the file, against the true opening."""
    p = values(harvester_machine(identified[1]).components["boom_stick"]).p
    points = [f"{kind}_{k}" for kind in ("command", "opening") for k in range(1, 11)]
    table = SimpleNamespace(**{point: p[f"valve_{name}_{point}"] for point in points})
    pieces = opening_curve.pieces(table)
    volts = np.arange(3.0, 10.01, 0.25)
    opened = p["valve_area"] * np.array([float(pieces.opening(v)) for v in volts])
    # C_d and density of the machine are others than those of the bench: the product counts
    scale = p["valve_discharge_coefficient"] / bench.C_D * np.sqrt(bench.DENSITY / p["density"])
    true = bench.AREA * bench.VALVES[VALVE][edge](volts)
    # 2.5 %: ten points for a curve with two bends; 1 % at the measured commands
    assert scale * opened == pytest.approx(true, rel=0.025)
