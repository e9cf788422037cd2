"""Compensated and detailed drives of a crane: it holds its load, flows, settings and numbers of its file."""

from functools import cache

import numpy as np
import pytest
from crane.test_crane import CRANES, changed
from kit.equations import Part, corners, piston_areas, played

from fmus.contract import quantities
from fmus.crane.description import read
from fmus.crane.machine import FIDELITIES, crane_machine
from fmus.machine.machine import wiring
from fmus.monolith import join
from fmus.parameters import numbers, values

AXES = ("boom", "jib", "extension")


@cache
def loader():
    """The machine of the example."""
    return crane_machine(read(CRANES / "loader.toml"))


def driven(variant, lever, stop):
    """Time and outputs behind the load-sensing pump, as one ODE; lever: commands (times, values)."""
    chosen = loader().chosen(drives=variant, supply="load_sensing")
    time, commands = corners(stop, {"boom_command": lever}, rate=50)
    return played(join(chosen, *wiring(chosen)), time, commands, tolerance=1e-8)


def of(machine, variant, part="drives"):
    """Parameters of a part, by name."""
    return numbers(machine.families[part][variant])["parameters"]


def test_counterbalance_valves_hold_the_load():
    """In 20 s no piston moves farther than its valves leak; behind spool valves it moves 50 times as far."""
    found = driven("compensated", ([0, 20], [0, 0]), 20.0)
    p = values(loader().families["drives"]["compensated"]).p
    for name in AXES:
        x = found[f"manipulator.{name}_position"]
        pressures = [found[f"drives.{name}_{side}_pressure"].max() for side in ("head", "rod")]
        leaked = p["counterbalance_leakage"] * 20.0 * max(pressures)
        # of the smaller area; 5 um more by what the pressures of the start settle
        assert np.ptp(x) < leaked / min(piston_areas(p, name)) + 5e-6
    spools = driven("quasistatic", ([0, 20], [0, 0]), 20.0)
    drift = [np.ptp(run["manipulator.boom_angle"]) for run in (found, spools)]
    assert 50 * drift[0] < drift[1]
    assert np.ptp(found["manipulator.slew_angle"]) < 1e-8  # rad: rounding, nothing turns it


@pytest.mark.parametrize("variant", ["compensated", "detailed"])
def test_the_lever_moves_the_boom_and_it_stays_where_it_stops(variant):
    """Up and down by at least 2 degrees, each to a place about which it sways by less than half a degree."""
    lever = ([0, 0.3, 1, 1.3, 2.5, 2.8, 3.5, 3.8, 5], [0, 3, 3, 0, 0, -3, -3, 0, 0])
    found = driven(variant, lever, 5.0)
    time, angle = found["time"], np.degrees(found["manipulator.boom_angle"])
    top, end = (angle[(time > t) & (time <= t + 0.7)] for t in (1.8, 4.3))  # two periods of the boom
    assert min(top.mean() - angle[0], top.mean() - end.mean()) > 2
    assert max(np.ptp(top), np.ptp(end)) < 1.0


def test_a_section_passes_its_flow_at_any_load(tmp_path):
    """At full command the flow of the file; from 20 to 150 bar only the droop of the compensator."""
    path = changed(tmp_path, ('valve = "40 mm2", hose = "3 m"', 'flow = "90 l/min", hose = "3 m"'))
    part = Part(crane_machine(read(path)).families["drives"]["compensated"])
    p, flows = part.p, []
    for load in (20e5, 150e5):
        x = part.start(boom_head_valve_pressure=load)
        sensed = {"load_sensing_pressure": load, "supply_pressure": load + 20e5, "boom_command": 10.0}
        flows.append(part(x, **sensed)[1]["boom_meter_in_flow"])
    # the droop of 20 bar instead of 100 bar over the section; edges that leak 20 mL/min
    assert flows == pytest.approx([90 / 6e4 * np.sqrt(1 - 80e5 * p["compensator_droop"])] * 2, rel=1e-3)
    assert p["jib_section_flow"] == pytest.approx(0.62 * 40e-6 * np.sqrt(2 * 12e5 / 870), rel=1e-12)


def test_settings_follow_the_pressure_of_the_file(tmp_path):
    """With half the pressure all settings halve, and the valves open above every load that can be held."""
    path = changed(tmp_path, ('pressure = "215 bar"', 'pressure = "107.5 bar"'))
    machine = crane_machine(read(path))
    for part, variant in (("drives", "compensated"), ("drives", "detailed"), ("supply", "load_sensing")):
        full, half = of(loader(), variant, part), of(machine, variant, part)
        names = [
            n
            for n, x in full.items()
            if x.source == "derived" and x.unit == "Pa" and half[n].value != x.value
        ]
        assert len(names) == {"compensated": 4, "detailed": 1, "load_sensing": 2}[variant]
        for n in names:
            assert half[n].value == pytest.approx(full[n].value / 2, rel=1e-12)
    setting = of(loader(), "compensated")["counterbalance_pressure"].value
    assert 215e5 < setting < 1.1 * 215e5


def test_a_side_that_carries_much_has_a_low_pilot_ratio():
    """The boom rests on its head side, the jib on its rod side; the telescope carries little on both."""
    p = of(loader(), "compensated")
    found = [[p[f"{n}_{side}_pilot_ratio"].value for side in ("head", "rod")] for n in AXES]
    assert found == [[1.5, 4.5], [4.5, 1.5], [4.5, 4.5]]


def test_the_spool_of_a_joint_has_the_dead_band_of_its_file(tmp_path):
    """One joint with another dead band has another overlap; the others keep theirs."""
    path = changed(tmp_path, ('hose = "3 m" }', 'hose = "3 m", dead_band = "1 V" }'))
    p = of(crane_machine(read(path)), "detailed")
    overlaps = [p[f"{n}_valve_spool_overlap_pa"].value for n in ("slew", "boom", "jib")]
    assert overlaps == pytest.approx([0.06, 0.1, 0.06], rel=1e-12)


def test_a_longer_hose_has_more_lumps(tmp_path):
    """As `lumps_needed` says for the hoses of each joint: 12 m need more than 3 m, and a longer line too."""
    counts = []
    for length in ("3 m", "12 m"):
        path = changed(tmp_path, ('valve = "40 mm2", hose = "3 m"', f'valve = "40 mm2", hose = "{length}"'))
        sub = crane_machine(read(path)).families["drives"]["detailed"]
        names = list(quantities(sub.states))
        counts.append([sum(n.startswith(f"{j}_") for n in names) for j in ("boom", "jib")])
    assert counts[1][0] >= 3 * counts[0][0] - 12  # 12: states beside the lines
    assert counts[1][1] == counts[0][1]


@pytest.mark.parametrize("path", sorted(CRANES.glob("*.toml")), ids=lambda p: p.stem)
def test_each_example_has_all_variants(path):
    """Each part has the four fidelities, and each number the unit of its declaration and a source."""
    crane = read(path)
    machine = crane_machine(crane)
    for part in dict.fromkeys(j.part for j in crane.driven):
        assert list(machine.families[part]) == list(FIDELITIES)
        for sub in machine.families[part].values():
            assert {n: x.unit for n, x in numbers(sub)["parameters"].items()} == {
                n: q.unit for n, q in quantities(sub.parameters).items()
            }
            names = [n for g in ("states", "parameters", "inputs") for n in quantities(getattr(sub, g))]
            assert len(set(names)) == len(names)  # none is declared twice
