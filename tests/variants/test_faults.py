"""Faults as inputs: without one the machine is healthy, each acts, and energy closes while they do."""

import casadi as ca
import numpy as np
import pytest
from kit.cranes import machine
from kit.drives import closing_balance, random_point
from kit.equations import Part
from kit.mistakes import problem
from variants.test_additions import flows

from fmus.contract import quantities
from fmus.machine.parts import FERIC, feric
from orchestrator import run

MACHINE = feric(faults=True)
CASES = [(part, v) for part, vs in MACHINE.families.items() for v in vs if part != "manipulator"]
LEAK = 1e-6  # m2


def faults(sub):
    """Names of the faults."""
    return [n for n, q in quantities(sub.inputs).items() if q.text.startswith("Fault: ")]


def state(of, rng):
    """States and inputs without a fault; of supplies near the start, of drives in operation."""
    if of.sub.part in ("swing", "boom_stick"):
        x, u = random_point(of, rng)
    else:
        x = of.start() * rng.uniform(0.9, 1.1, of.start().size)
        u = {n: of.u[n] + 0.1 * rng.normal() * q.nominal for n, q in quantities(of.sub.inputs).items()}
    return x, u | dict.fromkeys(faults(of.sub), 0.0)


@pytest.mark.parametrize(("part", "variant"), CASES)
def test_without_a_fault_a_part_is_healthy(part, variant):
    """Rates and outputs are those of the part without faults, to rounding."""
    healthy, faulty = (Part(machine.families[part][variant]) for machine in (FERIC, MACHINE))
    none, rng = dict.fromkeys(faults(faulty.sub), 0.0), np.random.default_rng(1)
    for x, u in (state(healthy, rng) for _ in range(20)):
        for found, expected in zip(faulty(x, **u, **none), healthy(x, **u), strict=True):
            found = found if isinstance(found, np.ndarray) else {n: found[n] for n in expected}
            assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("part", "variant"), [*CASES, ("valve_actuation", "")])
def test_every_fault_acts(part, variant):
    """Some rate or output depends on it, at some of 30 states."""
    sub = MACHINE.families[part][variant] if variant else MACHINE.actuation
    of, names = Part(sub), faults(sub)
    everything = ca.vertcat(of.model.dx, of.model.y)
    columns = [list(quantities(sub.inputs)).index(n) for n in names]
    slopes = ca.Function("s", [of.model.x, of.model.u, of.model.p], [ca.jacobian(everything, of.model.u)])
    found, rng = np.zeros(len(names)), np.random.default_rng(2)
    for k in range(30):
        x, u = state(of, rng)
        # cold oil does not reach the cooler; a relief valve acts from its pressure on
        x = np.where(np.array(of.states, str) == "oil_temperature", 345.0, x)
        declared, share = quantities(sub.inputs), 0.95 if k % 2 else 0.05
        u |= {n: share * declared[n].maximum if n.endswith("loss") else 0.01 for n in names}
        slope = slopes(x, list((of.u | u).values()), list(of.p.values())).full()[:, columns]
        found = np.maximum(found, np.abs(slope).max(axis=0))
    assert (found > 0).all(), dict(zip(names, found, strict=True))


@pytest.mark.parametrize(("part", "variant"), CASES)
def test_no_size_of_a_fault_is_refused(part, variant):
    """At the largest size, or ten usual ones, from the start: requirements hold, and rates are finite."""
    of = Part(MACHINE.families[part][variant])
    m, declared = of.model, quantities(of.sub.inputs)
    required = ca.Function("required", [m.x, m.u, m.p], [m.require])
    for name in faults(of.sub):
        size = {name: declared[name].maximum or 10 * declared[name].nominal}
        x, u = of.start(size), list((of.u | size).values())
        assert required(x, u, list(of.p.values())).full().min(initial=1.0) > 0, name
        assert np.isfinite(of(x, **size)[0]).all(), name


@pytest.mark.parametrize("variant", ["lumped", "detailed", "compensated"])
def test_energy_closes_with_faults_at_work(variant):
    """Power in + convected = d(stored)/dt + heat, with leaks, seals and air."""
    of = Part(MACHINE.families["boom_stick"][variant])
    balance, rng, declared = closing_balance(of), np.random.default_rng(3), quantities(of.sub.inputs)
    for x, given in (state(of, rng) for _ in range(20)):
        balance(x, **given | {n: declared[n].nominal * rng.uniform(0, 0.5) for n in faults(of.sub)})


def test_a_leak_is_an_orifice_to_the_outside():
    """C_d A sqrt(2 P/rho) above the laminar range: 100 bar, 1 mm2; no air comes in below 0."""
    of = Part(MACHINE.families["boom_stick"]["lumped"])
    out = flows(of, {"boom_head_pressure": 1e7}, boom_head_leak=LEAK)["leak_head_pressure"]
    assert out == pytest.approx(0.62 * LEAK * np.sqrt(2 * 1e7 / of.p["density"]), rel=2e-3)
    assert flows(of, {"boom_head_pressure": -1e4}, boom_head_leak=LEAK)["leak_head_pressure"] == 0


def test_a_valve_with_a_fault():
    """A stuck spool does not move; without current it goes to the centre; more hysteresis is a wider play."""
    of = Part(MACHINE.actuation)
    x = of.start(boom_valve_command=2.0, stick_valve_command=2.0)
    at = {n: of.at(f"{n}_valve_command") for n in ("boom", "stick")}
    half = of.p["hysteresis"] * of.p["full_command"] / 2
    moving, stuck = (of(x, boom_command=8.0, stick_command=8.0, boom_spool_stuck=s)[0] for s in (0.0, 1.0))
    assert moving[at["boom"]] > 0
    assert stuck[at["boom"]] == 0
    assert stuck[at["stick"]] == moving[at["stick"]]
    assert of(x, boom_command=8.0, boom_driver_loss=1.0)[0][at["boom"]] < 0
    command = 2.0 + half + 0.2
    inside, wide = (of(x, boom_command=command, boom_hysteresis_added=h)[0][at["boom"]] for h in (0.0, 0.1))
    assert inside > 1.0  # V/s
    assert abs(wide) < 1e-3


def test_a_crane_has_faults_of_its_joints():
    """Inputs by joint and part; without a fault its drives are those of the healthy crane."""
    made = machine(faults=True)
    named = {n for sub in made.components.values() for n in faults(sub)} | {*faults(made.actuation)}
    assert named >= {"boom_head_leak", "slew_leak_a", "extension_seal_leakage", "jib_spool_stuck"}
    healthy, faulty = (Part(m.subsystems["drives"]) for m in (machine(), made))
    x, u = random_point(healthy, np.random.default_rng(4))
    assert faulty(x, **u)[0] == pytest.approx(healthy(x, **u)[0], rel=1e-12)


def test_an_input_takes_values_at_times(fmu_dir):
    """As a scenario that has its jumps; a name, a unit and an order that are wrong are told."""
    fmu = fmu_dir / "harvester.fmu"
    jumps = {"time": [0, 0.5 - 1e-6, 0.5, 1 - 1e-6, 1, 2], "boom_command": [0, 0, 3, 3, 0, 0]}
    given = run(fmu, jumps, stop=2, record="boom_angle")
    found = run(fmu, stop=2, record="boom_angle", fault={"boom_command": "3@0.5s,0@1s"})
    assert np.array_equal(given["boom_angle"], found["boom_angle"])
    both = run(fmu, {"time": [0, 2], "stick_command": [1, 1]}, fault={"boom_command": "3@0.5"})
    assert both.time[-1] == 2
    alone = run(fmu, {"time": [0, 2], "stick_command": [1, 1]})
    before = np.asarray(both.time) < 0.5
    assert np.array_equal(both["boom_angle"][before], alone["boom_angle"][before])
    assert abs(both["boom_angle"][-1] - alone["boom_angle"][-1]) > 1e-3
    for fault, message in (
        ({"boom_comand": "3@1s"}, "did you mean boom_command"),
        ({"boom_command": "3bar@1s"}, "expected a unit like V"),
        ({"boom_command": "3@1s,0@0.5s"}, "expected times in order, got 0.5s after 1 s"),
        ({"boom_command": "3@2s"}, "expected a time from 0 s to 2 s, the end, got 2s"),
        ({"boom_command": "0,5"}, "expected VALUE@TIME for each of several values, got '0'; a decimal point"),
        ({"boom_command": "inf@1s"}, "expected finite numbers"),
        ({"boom_command": "3@soon"}, "expected a number of seconds"),
    ):
        problem(lambda fault=fault: run(fmu, stop=2, fault=fault), message)
    driven = "expected an input that the scenario does not drive"
    problem(lambda: run(fmu, jumps, fault={"boom_command": "1@0.1s"}), driven)


def test_a_leak_is_in_front_of_the_counterbalance_valve():
    """With compensated drives oil is lost at the valve, else at the chamber, where the load presses."""
    for variant, node in (("compensated", "boom_head_valve_pressure"), ("lumped", "boom_head_pressure")):
        of = Part(MACHINE.families["boom_stick"][variant])
        healthy, leaking = (of(of.start(**{node: 1e7}), boom_head_leak=a)[0] for a in (0.0, LEAK))
        changed = {n for n, a, b in zip(of.states, healthy, leaking, strict=True) if a != b}
        assert changed == {node}
