"""Compensated and detailed drives of a crane: it holds its load, flows, settings and numbers of its file."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np
import pytest
from kit.cranes import EXAMPLES, changed, crane, machine
from kit.equations import Part, corners, piston_areas, played

from fmus.contract import column, flat, quantities, symbols
from fmus.crane.description import read
from fmus.crane.machine import FIDELITIES, crane_machine
from fmus.machine.machine import wiring
from fmus.machine.parts import FERIC
from fmus.monolith import join
from fmus.parameters import numbers, values

AXES = ("boom", "jib", "extension")


@cache
def other():
    """The loader whose boom has its section by the flow, a hose of 12 m and a dead band of 1 V."""
    boom = 'flow = "90 l/min", hose = "12 m", dead_band = "1 V"'
    with TemporaryDirectory() as folder:
        return crane_machine(read(changed(Path(folder), ('valve = "40 mm2", hose = "3 m"', boom))))


def driven(variant, lever, stop, tolerance=1e-6):
    """Time and outputs behind the load-sensing pump, as one ODE; lever: commands (times, values)."""
    chosen = machine().chosen(drives=variant, supply="load_sensing")
    time, commands = corners(stop, {"boom_command": lever}, rate=50)
    return played(join(chosen, *wiring(chosen)), time, commands, tolerance=tolerance)


def of(built, variant, part="drives"):
    """Parameters of a part, by name."""
    return numbers(built.families[part][variant])["parameters"]


def test_counterbalance_valves_hold_the_load():
    """In 20 s no piston moves farther than its valves leak; behind spool valves it moves 50 times as far."""
    found = driven("compensated", ([0, 20], [0, 0]), 20.0, tolerance=1e-8)
    p = values(machine().families["drives"]["compensated"]).p
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


def test_a_section_passes_its_flow_at_any_load():
    """At full command the flow of the file; from 20 to 150 bar only the droop of the compensator."""
    part = Part(other().families["drives"]["compensated"])
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
    with_half = crane_machine(read(path))
    for part, variant in (("drives", "compensated"), ("drives", "detailed"), ("supply", "load_sensing")):
        full, half = of(machine(), variant, part), of(with_half, variant, part)
        derived = [n for n, x in full.items() if x.source == "derived" and x.unit == "Pa"]
        names = [n for n in derived if half[n].value != full[n].value]
        assert len(names) == {"compensated": 4, "detailed": 1, "load_sensing": 2}[variant]
        for n in names:
            assert half[n].value == pytest.approx(full[n].value / 2, rel=1e-12)
    setting = of(machine(), "compensated")["counterbalance_pressure"].value
    assert 215e5 < setting < 1.1 * 215e5


def test_a_side_that_carries_much_has_a_low_pilot_ratio():
    """The boom rests on its head side, the jib on its rod side; the telescope carries little on both."""
    p = of(machine(), "compensated")
    found = [[p[f"{n}_{side}_pilot_ratio"].value for side in ("head", "rod")] for n in AXES]
    assert found == [[1.5, 4.5], [4.5, 1.5], [4.5, 4.5]]


def test_the_spool_of_a_joint_has_the_dead_band_of_its_file():
    """One joint with another dead band has another overlap; the others keep theirs."""
    p = of(other(), "detailed")
    overlaps = [p[f"{n}_valve_spool_overlap_pa"].value for n in ("slew", "boom", "jib")]
    assert overlaps == pytest.approx([0.06, 0.1, 0.06], rel=1e-12)


def test_a_longer_hose_has_more_lumps():
    """As `lumps_needed` says for the hoses of each joint: 12 m need more than 3 m, and a longer line too."""
    counts = []
    for made in (machine(), other()):
        names = list(quantities(made.families["drives"]["detailed"].states))
        counts.append([sum(n.startswith(f"{j}_") for n in names) for j in ("boom", "jib")])
    assert counts[1][0] >= 3 * counts[0][0] - 12  # 12: states beside the lines
    assert counts[1][1] == counts[0][1]


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_example_has_all_variants(name):
    """Each part has the four fidelities, and each number the unit of its declaration and a source."""
    families = machine(name).families
    for part in dict.fromkeys(j.part for j in crane(name).driven):
        assert list(families[part]) == list(FIDELITIES)
        for sub in families[part].values():
            given, declared = numbers(sub)["parameters"], quantities(sub.parameters)
            assert {n: x.unit for n, x in given.items()} == {n: q.unit for n, q in declared.items()}
            names = [n for g in ("states", "parameters", "inputs") for n in quantities(getattr(sub, g))]
            assert len(set(names)) == len(names)  # none is declared twice


@pytest.mark.parametrize("built", [machine, lambda: crane_machine(crane("patu")), lambda: FERIC])
def test_open_rate_inputs_hold_the_start(built):
    """What is only the rate of other inputs starts at 0, exactly; no start value of a system follows it."""
    found = dict[str, float]()
    for sub in (s for variants in built().families.values() for s in variants.values()):
        declared, start = quantities(sub.inputs), values(sub).u
        rates = {q.rate for q in declared.values()} - {n for n, q in declared.items() if q.rate} - {None}
        found |= {f"{sub.name}.{n}": start[n] for n in rates}
        x, u, p = (symbols(group) for group in (sub.states, sub.inputs, sub.parameters))
        initial = column(*sub.initial(x, u, p).values())
        assert not any(ca.depends_on(ca.SX(initial), flat(u)[n]) for n in rates)
    assert len(found) > 10
    assert not any(found.values())
