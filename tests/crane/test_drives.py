"""Drives of joints against differences, forces in the pins, closed forms and the balance of energy."""

import cmath
import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fmus.components.linkage import Cylinder, Drive, FourBar, Motor, Telescope

# lengths of a forwarder loader (Ganguly and Le Duc 2017), pins made up
JIB = FourBar((-2.2, 0.45), 1.068, (-0.35, -0.05), 0.43, 0.452, (0.22, 0.1), "above")
DRIVES: dict[str, Drive] = {
    "motor": Motor(17.5),
    "telescope": Telescope(0.4),
    "cylinder": Cylinder((0.3, -0.9), (1.1, 0.1), 0.7),
    "above": JIB,
    "below": FourBar((-2.2, 0.45), 1.068, (-0.35, -0.05), 0.43, 0.452, (0.22, 0.1), "below"),
}
seeds = st.integers(0, 2**32 - 1)


def at(drive, q):
    """Position, J and dJ/dq as numbers."""
    found = drive.at(q)
    return [float(ca.DM(value)) for value in (found.position, found.arm, found.arm_derivative)]


def values(*expressions):
    """Expressions without symbols as numbers."""
    return [float(ca.DM(e)) for e in expressions]


def random_linkage(seed):
    """A four-bar linkage at least 0.1 m from its limits, and the angle [rad] of its joint."""
    rng = np.random.default_rng(seed)
    pivot, pin = (tuple(place) for place in rng.uniform(-0.6, 0.6, (2, 2)).tolist())
    rocker, coupler = rng.uniform(0.2, 0.8, 2).tolist()
    base, side = (-2.0, float(rng.uniform(-0.5, 0.5))), ("above", "below")[rng.integers(2)]
    drive, q = FourBar(base, 1.0, pivot, rocker, coupler, pin, side), float(rng.uniform(-3, 3))
    assume(values(drive.margin(q))[0] > 0.1)
    return drive, q


def slope(function, q):
    """Central difference of fourth order."""
    h = 3e-4
    return (8 * (function(q + h) - function(q - h)) - function(q + 2 * h) + function(q - 2 * h)) / (12 * h)


def check_slopes(drive, q):
    """J and dJ/dq are the differences of x and J."""
    _, arm, arm_derivative = at(drive, q)
    # truncation h^4/30 = 3e-16 of the fifth derivative, below 1e7 near a limit; rounding 1e-15/h
    assert slope(lambda s: at(drive, s)[0], q) == pytest.approx(arm, abs=1e-8)
    assert slope(lambda s: at(drive, s)[1], q) == pytest.approx(arm_derivative, abs=1e-8)


@pytest.mark.parametrize("name", DRIVES)
def test_arm_and_its_derivative_are_slopes(name):
    """J = dx/dq and dJ/dq by central differences over the range of a joint."""
    for q in np.linspace(-0.6, 0.6, 13).tolist():
        check_slopes(DRIVES[name], q)


@given(seed=seeds)
def test_arm_of_any_four_bar_linkage_is_a_slope(seed):
    """The same for linkages of any sizes in any position."""
    check_slopes(*random_linkage(seed))


def complex_pins(drive, q):
    """Pins of rocker and link, end of the rocker, base of the cylinder, as complex numbers from the joint."""
    end = complex(*values(*drive.rocker_end(q)))
    pivot, base = complex(*drive.pivot), complex(*drive.base)
    return pivot, complex(*drive.pin) * cmath.exp(1j * q), end, base


@given(seed=seeds)
def test_rocker_and_coupler_meet_on_their_side(seed):
    """They meet at the lengths of rocker and coupler from their pins, on the side that `assembly` names."""
    drive, q = random_linkage(seed)
    pivot, pin, end, base = complex_pins(drive, q)
    # exact identities, rounding only; the square root of a margin of 0.1 m loses a digit
    assert abs(end - pivot) == pytest.approx(drive.rocker, rel=1e-13)
    assert abs(end - pin) == pytest.approx(drive.coupler, rel=1e-13)
    assert abs(end - base) - drive.closed == pytest.approx(at(drive, q)[0], abs=1e-13)
    left = ((end - pivot) * (pin - pivot).conjugate()).imag > 0
    assert left == (drive.assembly == "above")


@given(seed=seeds)
def test_forces_in_the_pins_of_a_linkage_make_its_torque(seed):
    """J is the torque of the coupler, whose force and that of the rocker balance 1 N of the cylinder."""
    drive, q = random_linkage(seed)
    pivot, pin, end, base = complex_pins(drive, q)
    along = [(end - other) / abs(end - other) for other in (base, pivot, pin)]
    columns = np.array([[e.real, e.imag] for e in along]).T
    _, coupler = np.linalg.solve(columns[:, 1:], -columns[:, 0])  # balance at their joint
    torque = (pin.conjugate() * -coupler * along[2]).imag  # the coupler pushes on the link's pin
    # exact identity, rounding only; rocker and coupler are at least 0.1 m from a line
    assert torque == pytest.approx(at(drive, q)[1], abs=1e-12)


def test_margin_is_zero_where_rocker_and_coupler_are_in_line():
    """The margin is the distance of the pins from the sum and the difference of the lengths; x ends there."""
    drive = FourBar((-2.0, 0.5), 1.0, (-1.0, 0.0), 0.7, 0.6, (0.5, 0.0), "above")
    stretched = math.acos((1.3**2 - 1 - 0.5**2) / (2 * 0.5))  # pins 1.3 m apart
    # rounding only, of lengths of 1 m
    assert values(drive.margin(stretched)) == pytest.approx([0.0], abs=1e-15)
    assert values(drive.margin(math.pi / 2)) == pytest.approx([1.3 - math.sqrt(1.25)], abs=1e-15)
    folded = FourBar((-2.0, 0.5), 1.0, (-1.0, 0.0), 0.2, 0.75, (0.5, 0.0), "above")
    assert values(folded.margin(math.pi)) == pytest.approx([0.5 - 0.55], abs=1e-15)
    assert math.isfinite(at(drive, stretched + 1e-3)[0])
    assert math.isnan(at(drive, stretched - 1e-3)[0])
