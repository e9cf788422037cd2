"""The complete controller: its transcription from docs/control.md, bumpless transfer, numbers, recovery."""

from collections import ChainMap
from types import SimpleNamespace as Group

import casadi as ca
import numpy as np
import pytest
from equations.controller_transcription import AXES, Arm, written
from hypothesis import given
from hypothesis import strategies as st
from kit.fmu import driving
from kit.properties import examples
from kit.steering import INPUTS, OUTPUTS, PART, STATES, V, at, measured, rates

from fmus.contract import quantities
from fmus.controller.harvester import OfMachine, OfSwing
from fmus.controller.model import CONTROLLER
from fmus.machine.build import harvester_machine
from fmus.machine.parts import FERIC
from fmus.parameters import numbers, values

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


# ---- docs/control.md is enough to write the controller: its transcription agrees with the project


def drawn(rng: np.random.Generator, wide: float) -> tuple[dict, dict, dict]:
    """States, inputs and parameters: around a pose in the strokes, `wide` times the usual spread."""
    p = {n: v * rng.uniform(0.9, 1.1) for n, v in V.p.items()} | {"feedback": rng.choice([0.0, 0.5, 1.0])}
    p["learning"] = rng.choice([0.0, 0.5, 1.0])
    p["hysteresis"] *= rng.choice([0.0, 1.0])
    p["singular_share"] = rng.uniform(0, 0.8)  # the strokes end far from the singularity of the usual 0.2
    p |= {f"{n}_section_flow": rng.choice([0.0, rng.uniform(1e-3, 4e-3)]) for n in AXES}
    p |= {f"{n}_rod_section_flow": rng.choice([0.0, rng.uniform(1e-3, 4e-3)]) for n in AXES[1:]}
    angles = {"swing": rng.uniform(-7, 7), "boom": rng.uniform(-0.4, 0.95), "stick": rng.uniform(-2.1, -0.6)}
    u = {n: rng.uniform(-wide, wide) for n in V.u}
    u |= {f"{n}_angle": a for n, a in angles.items()}
    u |= {n: rng.uniform(-0.1, 1.1) * 20e6 for n in u if "pressure" in n} | {"tank_pressure": 2e5}
    u |= {"engaged": rng.choice([-0.2, 0.0, 0.4, 1.0, 1.3]), "follow": rng.choice([-0.2, 0.0, 0.7, 1.0, 1.2])}
    x = {n: 0.3 * wide * rng.normal() for n in V.x}
    x |= {f"reference_{n}": a + 0.02 * wide * rng.normal() for n, a in angles.items()}
    x |= {f"{n}_load": 5e4 * rng.normal() for n in AXES} | {"coordination": rng.uniform()}
    arm = Arm(x["reference_boom"], x["reference_stick"], Group(**p))
    u |= {"path_radius": arm.tip.real + 0.1 * wide * rng.normal()}
    u |= {"path_height": arm.tip.imag + 0.1 * wide * rng.normal()}
    u |= {"path_angle": x["reference_swing"] + 0.1 * wide * rng.normal()}
    u |= {f"{n}_lever": 20 * rng.uniform(-wide, wide) for n in AXES}
    return x, u, p


@examples(100)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.1, 1.0, 3.0]))
def test_the_document_gives_the_controller(seed, wide):
    """Rates and outputs from the document are those of the subsystem, at any state, input and number."""
    x, u, p = drawn(np.random.default_rng(seed), wide)
    found = PART.function(list(x.values()), list(u.values()), list(p.values()))
    document = written(Group(**x), Group(**u), Group(**p))
    for names, got, expected in zip((STATES, OUTPUTS), found, document, strict=False):
        for name, value in zip(names, got.full()[:, 0], strict=True):
            # rounding, and two steps of Halley's method in the inverse of the valve's curve, good to 1e-9
            room = 1e-8 * max(1.0, abs(x.get(name, 1.0)))
            assert value == pytest.approx(expected[name], rel=1e-8, abs=room), name
