"""Lines of T-lumps against the transmission line, and the adviser that says how many it takes."""

import math
from functools import cache
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import Part, piston_areas
from scipy.optimize import brentq

from fmus.boom_stick import AXES, VALUES, VARIANTS, variants
from fmus.components import hose
from fmus.components.chamber import AeratedOil
from fmus.components.circuit import Circuit, Node
from fmus.components.hose import HydraulicLine, lumps_needed
from fmus.contract import Quantity, nested, quantities
from fmus.drives.cylinder import CYLINDER
from fmus.drives.detailed import line_of, lumps_of
from fmus.parameters import values

# the hose of verification cases V02, V11, V19: 4 m of 3/4 in, rigid wall, no air
BETA, RHO, LENGTH, BORE, MU = 1.6e9, 970.0, 4.0, 0.75 * 0.0254, 0.030
SPEED = math.sqrt(BETA / RHO)
STIFF = 1e30  # Pa: a wall that does not give
WORK = 1e7  # Pa: far above the pressure at which the oil cavitates
CLOSED_END = (False, True)  # a constant pressure at the inlet, the outlet shut
ASKED = {"length": st.floats(0.3, 6.0), "bandwidth": st.floats(20.0, 400.0), "error": st.floats(0.005, 0.15)}


def oil(viscosity: float) -> AeratedOil:
    return AeratedOil(density=RHO, viscosity=viscosity, bulk_modulus=BETA, air_share=0.0, air_exponent=1.4)


def pipe(wall: float = STIFF, length: float = LENGTH) -> HydraulicLine:
    """A line without air and with hardly any friction."""
    laminar = 128 * 1e-12 * length / (math.pi * BORE**4)
    return HydraulicLine(length, BORE, hose.ShortLine(laminar, 0.0), wall, oil(1e-12))


def in_between(one: HydraulicLine, lumps: int, pressure: float) -> tuple[dict[str, ca.SX], Circuit]:
    """States of a line between two nodes of one pressure, and the circuit."""
    flows = dict.fromkeys(("first", "last"), Quantity("m3/s", "Flow"))
    states = hose.line_states(flows, "inner", "", "the line", lumps)
    x = {name: ca.SX.sym(name) for name in states.all()}
    ends = Circuit({"inlet": Node(pressure), "outlet": Node(pressure)}, {})
    return x, ends | hose.ladder(one, states, SimpleNamespace(**x), "inlet", "outlet")


@cache
def jacobian(one: HydraulicLine, lumps: int) -> np.ndarray:
    """df/dx of the component at rest: flows, pressures, between two constant pressures."""
    x, circuit = in_between(one, lumps, WORK)
    symbols, rates = ca.vertcat(*x.values()), ca.vertcat(*(circuit.rates[name] for name in x))
    found = ca.Function("J", [symbols], [ca.jacobian(rates, symbols)])
    return found([0.0] * (lumps + 1) + [WORK] * lumps).full()


def modes(matrix: np.ndarray) -> np.ndarray:
    """Frequencies [Hz] of the modes that oscillate, in order."""
    omega = np.linalg.eigvals(matrix).imag
    return np.sort(omega[omega > 1e-3]) / (2 * math.pi)


def ended(matrix: np.ndarray, lumps: int, closed_in: bool, closed_out: bool) -> np.ndarray:
    """The line with ends shut: a flow that stays zero is no state."""
    gone = [0] * closed_in + [lumps] * closed_out
    keep = [i for i in range(len(matrix)) if i not in gone]
    return matrix[np.ix_(keep, keep)]


@pytest.mark.parametrize("n", [1, 6, 64])
def test_modes_are_those_of_the_dispersion_relation(n):
    """Every mode of the ladder lies at 2 N C_0/l sin(k l/2N) with the wave number k of the line's mode.

    With both ends open, one or both shut; so the error falls with the square of N.
    """
    for closed, waves in ((CLOSED_END, np.arange(n) + 0.5), ((False, False), np.arange(1, n + 1))):
        exact = n * SPEED / (math.pi * LENGTH) * np.sin(waves * math.pi / (2 * n))
        # exact identity; eigenvalues of a matrix with entries from 1e-7 to 1e12 to nine digits
        assert modes(ended(jacobian(pipe(), n), n, *closed)) == pytest.approx(exact, rel=1e-9)
    both = modes(ended(jacobian(pipe(), n), n, True, True))
    assert both == pytest.approx(exact[:-1], rel=1e-9)
    # V02: one lump, and the quarter wave with 64
    first = {1: math.sqrt(2) * SPEED / (2 * math.pi * LENGTH), 64: SPEED / (4 * LENGTH)}
    found = modes(ended(jacobian(pipe(), n), n, *CLOSED_END))
    assert n not in first or found[0] == pytest.approx(first[n], rel=2e-4)


@given(**ASKED, wall=st.floats(0.3e9, 5e9))
def test_the_adviser_keeps_its_promise(length, bandwidth, error, wall):
    """With the advised lumps every mode up to the bandwidth is low by `error` at most, whatever the ends."""
    one = pipe(wall=wall, length=length)
    n = lumps_needed(length, BORE, bandwidth, error, one.fluid, wall)
    speed = math.sqrt(1 / (1 / BETA + 1 / wall) / RHO)
    for shut in (CLOSED_END, (False, False), (True, True)):
        found = modes(ended(jacobian(one, n), n, *shut))
        step, first = speed / (2 * length), 0.5 if shut == CLOSED_END else 1.0
        for k, ladder in enumerate(found):
            exact = (first + k) * step
            # eigenvalues to nine digits
            assert exact > bandwidth or -error - 1e-9 <= ladder / exact - 1 <= 1e-9
        assert (first + len(found)) * step > bandwidth  # no mode of the line is missing


@pytest.mark.parametrize("n", range(1, 20))
def test_what_n_lumps_just_reach_takes_n(n):
    """The bandwidth at which n lumps err by 1 - sin(1): rounding of the quotient asks for no more."""
    bandwidth = 2 * n * SPEED / (2 * math.pi * LENGTH)
    for more, lumps in ((1.0, n), (1 + 1e-9, n + 1), (0.49, math.ceil(0.49 * n))):
        assert lumps_needed(LENGTH, BORE, more * bandwidth, 1 - math.sin(1), oil(1e-12)) == lumps


def test_a_narrow_bore_needs_more_lumps():
    """Friction of sqrt(3) times w I doubles |R + jw I|, so waves are as many as in a line sqrt(2) longer."""
    narrow = math.sqrt(32 * MU / RHO / (2 * math.pi * 100.0 * math.sqrt(3)))  # R = 32 mu l/(A d^2)
    found = lumps_needed(4.0, narrow, 100.0, 0.005, oil(MU))
    wide, longer = (lumps_needed(n * 4.0, 0.02, 100.0, 0.005, oil(1e-12)) for n in (1, math.sqrt(2)))
    assert found == longer > wide


def test_default_hoses_have_the_default_lumps():
    """The default states are those of the adviser; fewer or more on demand, also by axis."""
    states = quantities(VARIANTS["detailed"].states)
    for axis in AXES:
        found = sum(name.startswith(f"{axis.name}_head_hose_pressure_") for name in states)
        assert found == lumps_of(VALUES)(axis)
    mixed = quantities(variants(lumps={"boom": 1, "stick": 3})["detailed"].states)
    assert sum("hose_pressure" in name for name in mixed) == 2 * (1 + 3)


def hose_errors(lumps: int) -> tuple[np.ndarray, float]:
    """Errors of the first mode of each hose of boom_stick, and the highest of these modes [Hz].

    Linearised with closed valves, locked pistons, no air and hardly any friction.
    """
    part = Part(variants(lumps=lumps)["detailed"], air_share=0.0, viscosity=1e-7, hose_wall_modulus=1e9)
    rest = [WORK if "pressure" in n else 0.0 for n in part.states]
    exact = hose_modes(part.p)
    found = modes(part.of(ca.jacobian(part.model.dx, part.model.x))(rest)[0])
    # the first mode of each of the four hoses; the spools (21 Hz) and second modes lie outside
    found = found[(found > 0.7 * exact[0]) & (found < 1.1 * exact[-1])]
    return found / exact - 1, exact[-1]


def hose_modes(p: dict[str, float]) -> np.ndarray:
    """First frequency [Hz] of each hose: shut at the valve, the locked chamber's compliance at the other end.

    tan(kl) = -kl C_chamber/C_hose, from the line's equations with P = cos(kx).
    """
    sub, found = variants(lumps=1)["detailed"], []
    u, numbers = values(sub).u, nested(sub.parameters, p)
    for axis in ("boom", "stick"):
        one = line_of(CYLINDER, getattr(numbers, axis), numbers)
        head, rod = piston_areas(p, axis)
        x, stroke, dead = u[f"{axis}_position"], p[f"{axis}_stroke"], p[f"{axis}_dead_volume"]
        modulus = 1 / (1 / p["bulk_modulus"] + 1 / p["hose_wall_modulus"])
        for chamber in (dead + head * x, dead + rod * (stroke - x)):
            ratio = chamber / p["bulk_modulus"] / (one.volume / modulus)
            kl = brentq(lambda a, r=ratio: math.sin(a) + a * r * math.cos(a), math.pi / 2, math.pi)
            found.append(kl * math.sqrt(modulus / p["density"]) / (2 * math.pi * one.length))
    return np.sort(found)


def test_the_subsystem_has_the_modes_of_its_hoses():
    """Linearised, boom_stick shows the first mode of each hose between valve and chamber, with order two."""
    errors = [hose_errors(lumps)[0] for lumps in (2, 4, 8)]
    ratios = np.array(errors[:-1]) / errors[1:]
    # order two; the next terms are some percent with two lumps
    assert ratios == pytest.approx(4.0, rel=0.06)


def test_the_adviser_holds_at_real_ends():
    """Between a closed valve and a chamber the advised hoses are within the error that was asked for."""
    errors, highest = hose_errors(max(map(lumps_of(VALUES), AXES)))
    assert highest < 150.0  # Hz: the bandwidth is 75
    assert np.abs(errors).max() < 0.05


def test_a_line_of_one_pressure_has_the_cavity_of_one_volume():
    """At the vapour pressure C_ref dP, 5e-9 m3, e^3 times as much 15 kPa below, however many lumps."""
    for n in (1, 2, 5):
        for pressure, volume in ((-20e3, 5e-9), (-35e3, math.e**3 * 5e-9)):
            x, circuit = in_between(pipe(), n, 0.0)
            volumes = ca.Function("V", [ca.vertcat(*x.values())], [circuit.void_volume])
            found = float(volumes([0.0] * (n + 1) + [pressure] * n))
            assert found == pytest.approx(volume, rel=1e-13)  # rounding
