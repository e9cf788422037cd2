"""The complete controller: bumpless transfer, signs, dependencies, parameter values, recovery."""

from collections import ChainMap

import casadi as ca
import numpy as np
import pytest
from kit.fmu import driving
from kit.steering import INPUTS, PART, STATES, V, at, measured, rates

from fmus.contract import quantities
from fmus.controller.harvester import ARM, OfMachine, OfSwing
from fmus.controller.model import CONTROLLER
from fmus.machine.build import harvester_machine
from fmus.machine.parts import FERIC
from fmus.parameters import numbers, values

AXES = tuple(a.name for a in ARM.axes)
FEEDBACK = [n for n in INPUTS if (n.startswith(AXES) and n.endswith(("_angle", "_speed"))) or "pressure" in n]
COMMANDS = [f"{axis}_command" for axis in AXES]


def test_at_rest_everything_stays():
    """Default: not engaged, levers and commands zero, the reference at the machine."""
    moved, shown = PART(PART.start())
    np.testing.assert_allclose(moved, 0, atol=1e-12)
    assert [shown[n] for n in COMMANDS] == [0, 0, 0]
    assert shown["tip_error"] == pytest.approx(0, abs=1e-12)


def test_feedforward_alone_uses_no_measurement():
    """With feedback 0 and engaged, commands and reference do not depend on measured inputs."""
    rows = [STATES.index(n) for n in STATES if n.endswith("_spool") or n.startswith("reference_")]
    columns = [INPUTS.index(n) for n in FEEDBACK]
    u = measured(0.2, -1.4, radial_velocity=0.3, swing_velocity=0.1, follow=0.5)
    x = PART.start(u) + 0.01 * np.random.default_rng(2).normal(size=len(STATES))

    whole = PART.model
    jacobian = ca.Function("j", [whole.x, whole.u, whole.p], [ca.jacobian(whole.dx[rows], whole.u[columns])])
    without, with_feedback = (
        jacobian(x, list(u.values()), list((V.p | {"feedback": f}).values())).full() for f in (0.0, 1.0)
    )
    assert (without == 0).all()
    assert (np.abs(with_feedback).sum(axis=0) > 0).sum() > 10  # nearly all count


def test_engaging_a_moving_machine_is_bumpless(fmu_dir):
    """Driven by a lever, then engaged at the same speed: the command bends, it does not jump."""
    u = {**V.u, "boom_lever": 1.6, "boom_speed": 0.1}
    with driving(fmu_dir / "controller.fmu", **u) as run:

        def step(count: int, **given: float) -> list[float]:
            found = []
            for _ in range(count):
                u["boom_angle"] += 0.01 * u["boom_speed"]
                found.append(run.set(**(u | given)).step(0.01)["boom_command"])
            return found

        step(40)
        assert run["boom_command"] == pytest.approx(1.6, rel=1e-6)
        # the measured angle is held over each step: half a step of 0.1 rad/s at 4.5 m is 2.3 mm
        assert run["tip_error"] < 3e-3
        radial, vertical = run["radial_lever"], run["vertical_lever"]
        engaged = step(5, engaged=1.0, radial_velocity=radial, vertical_velocity=vertical)
    # the machine moves as its valve says in steady motion, so the controller chooses the lever's command,
    # but for pressures of rest: 0.1 V of 2 V in the first 50 ms
    assert np.abs(np.diff([1.6, *engaged])).max() < 0.1


def test_the_correction_is_bounded_and_lets_go():
    """With saturated valves and a constant error the correction ends near its limit and decays afterwards."""
    u = measured(0.2, -1.4, follow=0.0, vertical_velocity=2.0)
    x = PART.start(u)
    behind = u | {"boom_angle": 0.15, "supply_pressure": 2e6}
    for _ in range(3000):
        x = x + 0.002 * rates(x, behind)
    for axis in AXES:
        assert abs(at(x, f"{axis}_gain")) < 1.5 * V.p["gain_limit"]
    free = u | {"engaged": 0.0}
    for _ in range(250):
        x = x + 0.002 * rates(x, free)
    for axis in AXES:
        assert abs(at(x, f"{axis}_gain")) < 1e-3


def test_numbers_are_those_of_the_machine():
    """Parameters of geometry, cylinders, valves and motor are only in the files of the parts."""
    found = numbers(CONTROLLER)["parameters"]
    for group, parts in ((OfMachine, ("manipulator", "boom_stick")), (OfSwing, ("swing",))):
        own = ChainMap(*(numbers(FERIC.subsystems[part])["parameters"] for part in parts))
        for name in quantities(group):
            here, there = found[name], own[name if name in own else name.removeprefix("swing_")]
            assert (here.value, here.unit) == (there.value, there.unit)


def test_a_set_of_numbers_changes_the_controller_too(tmp_path):
    """`harvester build --parameters`: of all parts, of one part, a gain, and of the controller alone."""
    entry = '[parameters.{}]\nvalue = {}\nunit = "{}"\nsource = "identified"\nnote = "bench"\n'
    given = (
        *(("valve_area", 4.1e-5, "m2"), ("stick_length", 3.0, "m"), ("piston_position_gain", 5.0, "1/s")),
        *(('"swing.valve_dead_band"', 0.8, "V"), ('"controller.density"', 900.0, "kg/m3")),
    )
    path = tmp_path / "set.toml"
    path.write_text("".join(entry.format(*one) for one in given), encoding="utf-8")
    found = values(harvester_machine(path).controller).p
    expected = {"valve_area": 4.1e-5, "swing_valve_area": 4.1e-5, "stick_length": 3.0}
    expected |= {"piston_position_gain": 5.0, "swing_valve_dead_band": 0.8, "valve_dead_band": 0.6}
    expected |= {"density": 900.0, "swing_density": 970.0}
    assert {n: found[n] for n in expected} == expected
