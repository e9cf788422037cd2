"""`harvester energy`: heat by function and cause, from the engine to the load, of any machine."""

import json

import numpy as np
import pytest
from kit.mistakes import entry, refused

from orchestrator import Trace, run
from orchestrator.__main__ import main
from orchestrator.data.trace_writer import write_trace
from orchestrator.pages.figures import PALETTE
from orchestrator.results.energy import LAST, energy, figure, table

TIME = np.linspace(0.0, 2.0, 21)
POWERS = entry(__file__, "powers")
# at the end [J]
ENERGIES = {"crane.stored_energy": 12e3, "pump.stored_energy": 10e3, "arm.stored_energy": 5e3}


def crane(**changed):
    """A trace of the crane."""
    share = TIME / TIME[-1]
    values = {name: 2 * value * share for name, value in POWERS.items()}
    values |= {name: 1e3 + (value - 1e3) * share for name, value in ENERGIES.items()}
    return Trace(TIME, {n: v for n, v in (values | changed).items() if v is not None})


def test_energies_are_the_integrals_of_what_the_names_tell():
    """Twice the mean power of 2 s; heat is that of its function or supply, and nothing of the mechanics."""
    e = energy(crane(), "crane.csv")
    assert e.engine == pytest.approx(220e3)
    assert e.supplied == pytest.approx({"lift": 100e3, "lift_2": 60e3})
    assert e.load == pytest.approx({"lift": 20e3, "lift_2": -10e3})
    assert e.heat["lift"] == pytest.approx({"meter in": 50e3, "hose": 20e3})
    assert e.heat["lift_2"] == pytest.approx({"meter in": 70e3})
    assert e.heat["pump"] == pytest.approx({"leakage": 30e3})
    assert e.heat["saw_pump"] == pytest.approx({"pump friction": 8e3})
    assert len(e.heat) == 4
    assert e.stored == pytest.approx(11e3 + 9e3 - 2e3)
    assert e.remainder == pytest.approx(220e3 - 10e3 - 178e3 - 18e3)
    assert e.of("lift")["stored"] == pytest.approx(10e3)
    without = energy(crane(**{"pump.engine_power": None, "saw_pump.engine_power": None}), "-")
    assert without.engine == pytest.approx(160e3)
    assert set(without.heat) == {"lift", "lift_2"}


def test_runs_stand_side_by_side(tmp_path, monkeypatch, capsys):
    """A function that one run lacks, differences, JSON, a picture; a window in time is a part of it."""
    monkeypatch.chdir(tmp_path)
    less = {n: None for n in POWERS if "lift_2" in n}
    less["pump.engine_power"] = crane()["pump.engine_power"] / 2
    for name, trace in {"a.csv": crane(), "b.csv": crane(**less)}.items():
        write_trace(trace, name, "")
    assert main(["energy", "a.csv", "b.csv"]) == 0
    printed = capsys.readouterr().out
    rows = {tuple(line.split()[:-5]): line.split()[-5:] for line in printed.splitlines() if " " in line}
    assert rows["engine",] == ["220.00", "100", "120.00", "100", "-100.00"]
    assert rows["lift_2", "supplied"] == ["60.00", "27.3", "-", "-", "-60.00"]
    assert rows["remainder",][0] == "14"
    assert printed.index("saw_pump") < printed.index("lift") < printed.index("total")
    assert '<div class="plot"' in (tmp_path / "build" / "energy.html").read_text(encoding="utf-8")
    assert main(["energy", "a.csv", "--out", "e.png"]) == 0
    assert (tmp_path / "e.png").read_bytes().startswith(b"\x89PNG")
    capsys.readouterr()
    assert main(["energy", "a.csv", "--stop", "1", "--json", "--out", "a.png"]) == 0
    assert (tmp_path / "a.png").stat().st_size > 0
    data = json.loads(capsys.readouterr().out)
    assert list(data) == ["title", "verdict", "passed", "runs", "unreliable"]
    assert data["verdict"] == "a: 55 kJ, 4.55 % to the load"
    found = data["runs"]["a"]
    assert found["heat"]["lift"]["meter in"] == pytest.approx(50e3 / 4)
    assert found["remainder"] == pytest.approx(energy(crane().window(0, 1), "-").remainder)


def bars(panel):
    """Label and row of each bar -> its begin and its length."""
    outlines = [(line.name, line.time.reshape(-1, 6), line.values.reshape(-1, 6)) for line in panel.lines]
    found = [(name, x, y) for name, *both in outlines for x, y in zip(*both, strict=True)]
    return {(name, round(0.4 - y[2])): (x[0], x[1] - x[0]) for name, x, y in found}


def test_bars_are_as_long_as_what_they_show():
    """Of the engine and of each function, in kJ; negative parts are to the left of zero."""
    drawn = figure({"a": energy(crane(), "-")})
    # rounding only: from the negative load to all that the engine gave (30 + 8 + 100 + 60), 2 % at each end
    assert drawn.span == pytest.approx((-10 - 0.02 * 208, 198 + 0.02 * 208), rel=1e-9)
    of_engine, of_functions = map(bars, drawn.panels)
    assert of_engine["leakage", 0] == pytest.approx((0, 30))
    assert of_engine["lift_2", 0] == pytest.approx((138, 60))
    assert of_functions["hose", 0] == pytest.approx((50, 20))
    assert of_functions["load", 0] == pytest.approx((70, 20))
    assert of_functions["load", 1] == pytest.approx((0, -10))


@pytest.mark.parametrize("causes", [3, 13, 16])
def test_no_two_causes_have_one_colour_but_the_smallest(causes):
    """Of bars on one picture; those after the thirteenth are grey."""
    heat = {f"pump.cause_{k}_heat": np.full(21, 1e4 + 1e3 * k) for k in range(causes)}
    kept = {name: None for name in POWERS if name.endswith("_heat") and not name.startswith("lift_meter")}
    drawn = figure({"a": energy(crane(**kept, **heat), "-")})
    colours = {line.name: line.style["color"] for panel in drawn.panels for line in panel.lines}
    grey = [name for name, colour in colours.items() if colour == PALETTE.soft]
    several = [name for name, colour in colours.items() if list(colours.values()).count(colour) > 1]
    assert set(several) <= set(grey)
    sizes = {
        line.name: np.nanmax(np.abs(np.diff(line.time))) for panel in drawn.panels for line in panel.lines
    }
    others = [name for name in colours if name not in (*grey, *LAST)]
    assert max((sizes[n] for n in grey), default=0.0) <= min(sizes[n] for n in others)
    assert len(others) == min(13, len(colours.keys() - LAST))


def test_a_machine_at_rest_has_a_table():
    """Without any energy there are no shares."""
    still = Trace(TIME, dict.fromkeys(crane(), np.zeros_like(TIME)))
    assert table({"a": energy(still, "-")}).rows == [["total", "remainder", "0", "-"]]


def test_mistakes_are_one_line(tmp_path, monkeypatch, capsys):
    """A run without these outputs, no run, and a picture of an unknown format."""
    monkeypatch.chdir(tmp_path)
    write_trace(crane(**{n: None for n in POWERS if n.endswith("_heat")}), "old.csv", "")
    told = refused(capsys, ["energy", "old.csv"])
    assert "old.csv: expected signals NAME_hydraulic_power, NAME_mechanical_power " in told
    assert "expected the trace of a run, got none" in refused(capsys, ["energy"])
    told = refused(capsys, ["energy", "old.csv", "--out", "a.txt"])
    assert "--out a.txt: expected a file name ending in" in told


@pytest.mark.parametrize("drives", ["lumped", "compensated"])
def test_energies_of_the_machine(built, drives):
    """Causes sum to all heat; load, heat and what is stored leave no more than coupling and sampling."""
    variants = dict.fromkeys(("swing", "boom_stick"), drives) | {"supply": "load_sensing"}
    swap = {n: v for n, v in variants.items() if v != "lumped"}
    trace = run(built / "harvester.ssp", swap=swap, stop=1.5).trace
    e = energy(trace, "run")
    parts = ("supply", "swing", "boom_stick")
    total = sum(np.trapezoid(trace[f"{part}.dissipated_power"], trace.time) for part in parts)
    assert set(e.supplied) == {"swing", "boom", "stick"}
    assert e.all_heat == pytest.approx(total, rel=1e-9)  # the bar
    taken = np.trapezoid(trace["supply.hydraulic_power"], trace.time)
    # errors of the coupling and of the trapezoidal rule at 5 ms
    assert sum(e.supplied.values()) == pytest.approx(taken, rel=1e-3)
    assert abs(e.remainder) < 1e-4 * e.engine
    assert min(min(causes.values()) for causes in e.heat.values()) > -1e-9 * total
