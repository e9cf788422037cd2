"""`fmus.joints` with joints, laws and arms that no shipped machine has, and friction and stops of cranes."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from kit.equations import Part
from kit.mistakes import entry, problem, table

from fmus.components.chain import Link, Payload
from fmus.components.friction import Resistance
from fmus.contract import Group, Quantity, Scalar, Subsystem, quantities
from fmus.crane.description import read
from fmus.crane.manipulator import manipulator
from fmus.joints import JointModel, Mechanics
from fmus.manipulator.variables import ManipulatorInputs, ManipulatorState

G, LENGTH, MASS = 9.81, 0.8, 120.0
PENDULUM = entry(__file__, "pendulum")


class Inputs(Group):
    """Of an arm on a rail."""

    payload_mass: Scalar = quantities(ManipulatorInputs)["payload_mass"]
    cart_torque: Scalar = Quantity("N", "Force on the cart", 1e3)


class Parameters(Group):
    """Of all arms here."""

    stop_stiffness: Scalar = Quantity("N/m", "Stiffness of end stops", value=1e8)
    payload_grip_time: Scalar = Quantity("s", "Delay of the payload", value=0.2)
    coulomb: Scalar = Quantity("N.m", "Dry friction", value=40.0)


class Power(Group):
    """What all arms show."""

    kinetic_energy: Scalar = Quantity("J", "Kinetic energy")
    potential_energy: Scalar = Quantity("J", "Potential energy")
    dissipated_power: Scalar = Quantity("W", "Heat")


def states(*coordinates):
    """The group of the states of some joints."""
    members = {
        f"{n}_{k}": Quantity("1", f"{n} {k}", value=0.0) for n in coordinates for k in ("angle", "speed")
    }
    held = {n: quantities(ManipulatorState)[n] for n in ("held_mass", "payload_flow")}
    return type("States", (Group,), members | held)


def arm(joints, payload, **more):
    """A subsystem of joints, and its equations as numbers."""
    start = {f"initial_{j.coordinate}": Quantity("rad", "At the start", value=0.0) for j in joints}
    parameters = type("AllParameters", (Parameters,), start)
    groups = parameters, states(*(j.name for j in joints)), Inputs, Power
    views = {"views": lambda *_: {}} | more
    model = Mechanics(joints, *groups, lambda _: (0, 0, -G), payload, **views)
    return Part(Subsystem(**model.declared, name="arm", text="An arm"))


def universal(name, at, apart):
    """A universal joint: two revolute ones at right angles, some way apart."""
    pin = JointModel(f"{name}x", f"{name}x_angle", lambda _: Link(f"{name}x", "revolute", "x", at))
    yoke = JointModel(
        f"{name}y", f"{name}y_angle", lambda _: Link(f"{name}y", "revolute", "y", (0, 0, -apart), 0)
    )
    return pin, yoke


def test_a_universal_joint_swings_with_both_lengths():
    """Small angles: w^2 = g/l below the lower axis, g/(l + a) below the upper one; the other angle rests."""
    apart = 0.3
    own = arm(universal("head", (0, 0, 4), apart), lambda m, _: Payload(1, (0, 0, -LENGTH), MASS + m))
    for name, length in (("headx", LENGTH + apart), ("heady", LENGTH)):
        rates, _ = own(own.start(**{f"{name}_angle": 1e-4}))
        found = {n: rates[own.at(f"{n}_speed")] for n in ("headx", "heady")}
        assert found.pop(name) == pytest.approx(-G / length * 1e-4, rel=1e-7)  # of the sine
        assert [*found.values()] == pytest.approx([0.0], abs=1e-15)


def test_a_law_of_friction_without_states():
    """Coulomb's torque, rounded: heat is torque times speed, and no state is added."""

    def coulomb(_contact, speed, _x, p, damping):
        force = p.coulomb * ca.tanh(speed / 1e-3) + damping * speed
        return Resistance(force, force * speed)

    rod = JointModel(
        "rod", "rod_angle", lambda _: Link("rod", "revolute", "-y"), lambda _: 5.0, contacts=("rod", "")
    )
    own = arm((rod,), lambda m, _: Payload(0, (0, 0, -LENGTH), MASS + m), dry=coulomb)
    rates, shown = own(own.start(rod_speed=0.5))
    assert own.states == ["rod_angle", "rod_speed", "held_mass", "payload_flow"]
    assert shown["dissipated_power"] == pytest.approx((40 + 5 * 0.5) * 0.5, rel=1e-12)
    assert rates[own.at("rod_speed")] == pytest.approx(-42.5 / (MASS * LENGTH**2), rel=1e-12)


def crane(keys):
    """A pendulum as the file of a crane, 100 kg at 2 m."""
    own = Part(manipulator(read(Path("pendulum.toml"), PENDULUM.format(keys, 0).encode())))
    own.u["payload_mass"] = 100.0
    return own


def test_dry_friction_holds_a_pendulum_and_stops_it():
    """Below T_c/(m g l) it stays; above, each half period takes 2 T_c/(m g l) of its angle."""
    own = crane('friction = "98.1 N.m"')
    width = 98.1 / (100 * own.p["gravity"] * 2)  # rad
    still = own.follow(np.linspace(0, 5, 11), x=own.start(link_angle=0.9 * width))["link_angle"]
    # when the bristles carry it, it creeps below 1e-3 of the Stribeck speed (`fmus.components.friction`)
    assert np.ptp(still[2:]) < 4 * 1e-3 * own.p["dry_joint_stribeck_speed"]
    moved = own.follow(np.linspace(0, 5, 1001), x=own.start(link_angle=10 * width))
    turns = np.flatnonzero(np.diff(np.sign(moved["link_speed"][1:]))) + 1
    peaks = np.abs(moved["link_angle"][turns])[:3] / width
    # break-away and presliding of the law at each turn: below a tenth of what a half period takes
    np.testing.assert_allclose(peaks, [8, 6, 4], atol=0.2)


def test_end_stops_of_a_joint_throw_it_back():
    """Against stops without damping a pendulum keeps its energy, and goes beyond them by what they give."""
    own = crane('stop = { at = "30 deg", stiffness = "5 MN.m/rad", damping = 0 }')
    shown = own.follow(np.linspace(0, 2, 401), x=own.start(link_angle=np.radians(29.0), link_speed=1.0))
    energy = sum(shown[f"{n}_energy"] for n in ("kinetic", "potential", "elastic", "stop"))
    assert np.ptp(energy) < 1e-6 * shown["kinetic_energy"].max()  # of the integration
    angle = np.degrees(shown["link_angle"])
    given = np.degrees(np.sqrt(2 * shown["kinetic_energy"][0] / 5e6))  # of a spring, before gravity
    assert 30 < angle.max() < 30 + given + 0.6  # rad 0.01: the rounding of the stop
    assert angle.min() < -29
    assert np.abs(shown["link_stop_torque"]).max() > 1e4


@table(__file__, "mistakes", "keys, message")
def test_mistakes_of_friction_and_stops(keys, message):
    """One line each."""
    problem(lambda: crane(keys), message)
