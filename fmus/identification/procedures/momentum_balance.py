"""The machine's equation of motion as measured signals see it, filtered so that no acceleration is formed.

Paper eq. (4) by the generalised momenta h = M(q) q':

    dh/dt = f        f = tau + dT/dq - G        dT/dq = dM/dt q' - V

with M, V, G and tau of `fmus.manipulator` and the hydraulic torque and forces of `fmus.swing` (motor ports by
line resistance and leakage) and `fmus.boom_stick`, of measured pressures. Nothing is written twice.
Multiplied by a smooth bump phi of compact support and integrated by parts (Shinbrot 1957, modulating
functions):

    int phi'(t - s) h(s) ds = int phi(t - s) f(s) ds        at every t, e = phi * f - phi' * h

the same filter on both sides. h and f are functions of angles, speeds and pressures that one and the same
Savitzky-Golay filter has smoothed before, the speeds being its derivative. All of it is linear in the
sensors' noise, so a noise of the equation goes back to a noise of each sample by the transposed filters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem, quantities, symbolic, symbols
from fmus.identification.procedures.experiment_data import interpolated, noise_sd, tank_pressure
from fmus.identification.procedures.weak_form import modulating_function
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.recordings.derivatives import SavitzkyGolay
from fmus.identification.recordings.masks import good_all
from fmus.manipulator import MANIPULATOR, arm
from fmus.manipulator.design import POINT_MASS, VISCOUS
from fmus.manipulator.model import Design, forces
from fmus.manipulator.variables import ManipulatorInputs
from fmus.parameters import Number
from fmus.swing import SWING
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTHING = 0.06  # s, length of the polynomials: flat up to 15 Hz, far above the modes of the arm
ORDER = 4
WINDOW = 0.3  # s, length of the bump


@dataclass(frozen=True)
class Filters:
    """Kernels, each of odd length, in the order of convolution.

    step           between two smoothed samples [s]: of those of the clock, each `every`-th is kept
    smooth, rate   Savitzky-Golay value and derivative, over the clock
    bump, slope    phi dt, of sum one, and phi' dt, of first moment one, over the smoothed samples
    """

    step: float
    every: int
    smooth: Array
    rate: Array
    bump: Array
    slope: Array

    @property
    def loss(self) -> int:
        """SmoothedRecording of the clock without a result at each end."""
        return self.smooth.size // 2 + self.bump.size // 2 * self.every

    def gain(self, outer: Array) -> float:
        """Standard deviation of a speed, filtered by `outer`, over that of one sample of the angle [1/s]."""
        return float(np.linalg.norm(np.convolve(self.rate, stuffed(outer, self.every))))

    def smoothed(self, rows: Array) -> Array:
        """Values of signals (k, n), where the kernel lies within them."""
        return apply(self.smooth, rows)[:, :: self.every]

    def slopes(self, rows: Array) -> Array:
        """Their derivatives."""
        return apply(self.rate, rows)[:, :: self.every]

    def unsmoothed(self, values: Array, slopes: Array | None = None) -> Array:
        """The transpose of both together: gradients by smoothed values to gradients by samples."""
        back = transposed(self.smooth, stuffed(values, self.every))
        return back if slopes is None else back + transposed(self.rate, stuffed(slopes, self.every))


def filters(rate: float, window: float = WINDOW, every: int = 1) -> Filters:
    """The kernels for `rate` samples per second; lengths [s], or what a slow clock allows."""
    inner = SavitzkyGolay(rate, max(SMOOTHING, (ORDER + 2) / rate), ORDER)
    step, half = every / rate, max(round(window * rate / every / 2), 2)
    bump, slope = modulating_function(half + 1)
    smooth, slopes = (inner.weights[order][::-1] for order in (0, 1))
    return Filters(step, every, smooth, slopes, bump / bump.sum(), -slope / (bump.sum() * step))


def apply(kernel: Array, rows: Array) -> Array:
    """Each row (k, n) through a filter, only where the kernel lies within it."""
    return np.array([np.convolve(row, kernel, "valid") for row in rows])


def transposed(kernel: Array, rows: Array) -> Array:
    """The transpose of `apply`."""
    return np.array([np.convolve(row, kernel[::-1], "full") for row in rows])


def stuffed(rows: Array, every: int) -> Array:
    """With zeros between the samples, the transpose of keeping each `every`-th of (n - 1) every + 1."""
    full = np.zeros((*rows.shape[:-1], (rows.shape[-1] - 1) * every + 1))
    full[..., ::every] = rows
    return full


def covered(bad: Mask, width: int) -> Mask:
    """True where a kernel of `width` samples covers no bad sample, shape (n - width + 1,)."""
    return np.convolve(bad, np.ones(width), "valid") < 0.5


JOINTS = ("swing", "boom", "stick")
ANGLES = tuple(f"manipulator.{j}_angle" for j in JOINTS)
PRESSURES = {
    "swing": ("swing.swing_pressure_a", "swing.swing_pressure_b"),
    "boom": ("boom_stick.boom_head_pressure", "boom_stick.boom_rod_pressure"),
    "stick": ("boom_stick.stick_head_pressure", "boom_stick.stick_rod_pressure"),
}
ALL_PRESSURES = tuple(name for both in PRESSURES.values() for name in both)
SIGNALS = dict.fromkeys(ANGLES, "rad") | dict.fromkeys(ALL_PRESSURES, "Pa")
_LUMPED = Design(MANIPULATOR.states, MANIPULATOR.outputs, POINT_MASS, VISCOUS)
_PARTS = (SWING, BOOM_STICK, MANIPULATOR)
PARAMETERS = tuple(f"{sub.name}.{n}" for sub in _PARTS for n in quantities(sub.parameters))


@dataclass(frozen=True)
class EquationOfMotion:
    """Functions of (q, q', pressures, tank pressure, parameters), each column one sample.

    balance    -> h, f, each (3, n)
    slopes     -> dh/dtheta, df/dtheta, each (3 m, n), column by column
    gradients  -> entries of d(f, h)/d(q, q', pressures, parameters) that are not zero, (entries, n)
    entries    their rows, 0 to 5, and columns
    sway       -> d(f, df/dtheta.., h, dh/dtheta..)/dq', (3 * 2 * (1 + m) * 3, n), the speed slowest
    bend       -> d2f/dq_k'^2, (3 * 3, n), the speed k slowest
    pistons    (q, parameters) -> positions and moment arms of boom and stick, each (2, n)
    printed    (q, q', q'', ...) -> f - dh/dt, df_i/dq_i', x_i'/q_i', each (3, n); the first as (13) prints it
    """

    theta: tuple[str, ...]
    balance: ca.Function
    slopes: ca.Function
    gradients: ca.Function
    entries: tuple[tuple[int, int], ...]
    sway: ca.Function
    bend: ca.Function
    pistons: ca.Function
    printed: ca.Function


@dataclass(frozen=True)
class _Symbols:
    q: ca.SX
    w: ca.SX
    pressures: ca.SX
    tank: ca.SX
    p: ca.SX
    momentum: ca.SX
    force: ca.SX
    position: ca.SX
    lever: ca.SX


@lru_cache(maxsize=1)
def _equations() -> _Symbols:
    q, w = ca.SX.sym("q", 3), ca.SX.sym("w", 3)
    pressures, tank = ca.SX.sym("pressure", len(ALL_PRESSURES)), ca.SX.sym("tank")
    p = ca.SX.sym("p", len(PARAMETERS))
    x, own, u = symbols(MANIPULATOR.states), symbols(MANIPULATOR.parameters), symbols(ManipulatorInputs)
    measured = dict(zip(ALL_PRESSURES, ca.vertsplit(pressures), strict=True)) | {"swing.swing_speed": w[0]}
    outputs = ((SWING, "swing_torque"), (BOOM_STICK, "boom_force"), (BOOM_STICK, "stick_force"))
    hydraulics = [_output(sub, name, measured, tank, p) for sub, name in outputs]
    motion, rods = arm.mechanics(x, own, POINT_MASS), arm.pistons(x, own)
    terms = [motion.mass, motion.coriolis, motion.gravity, forces(_LUMPED, x, u, own)]
    terms += [ca.vertcat(*(r.position for r in rods)), ca.vertcat(*(r.triangle.arm for r in rods))]
    coordinates = [getattr(x, f"{j}_{kind}") for kind in ("angle", "speed") for j in JOINTS]
    applied = [u.swing_torque, u.boom_force, u.stick_force]
    old = ca.vertcat(*coordinates, *applied, *vars(own).values())
    new = ca.vertcat(q, w, *hydraulics, *_own(MANIPULATOR, p))
    mass, coriolis, gravity, tau, position, lever = ca.substitute(terms, [old], [new])
    momentum = mass @ w
    force = tau + ca.jtimes(momentum, q, w) - coriolis - gravity
    return _Symbols(q, w, pressures, tank, p, momentum, force, position, lever)


def _own(sub: Subsystem, p: ca.SX) -> list[ca.SX]:
    """The part's own parameters among those of the machine."""
    return [p[PARAMETERS.index(f"{sub.name}.{n}")] for n in quantities(sub.parameters)]


def _output(sub: Subsystem, name: str, measured: dict[str, Any], tank: ca.SX, p: ca.SX) -> ca.SX:
    """One output of a drive at measured pressures; it must not depend on what is not measured."""
    model, known = symbolic(sub), measured | {f"{sub.name}.tank_pressure": tank}
    declared = [
        (f"{sub.name}.{n}", s)
        for group, column in ((sub.states, model.x), (sub.inputs, model.u))
        for n, s in zip(quantities(group), ca.vertsplit(column), strict=True)
    ]
    old = [s for n, s in declared if n in known]
    new = [known[n] for n, _ in declared if n in known]
    wanted = model.y[list(quantities(sub.outputs)).index(name)]
    return ca.substitute(wanted, ca.vertcat(*old, model.p), ca.vertcat(*new, *_own(sub, p)))


@lru_cache(maxsize=8)
def motion(theta: tuple[str, ...]) -> EquationOfMotion:
    """The functions for these parameters."""
    e = _equations()
    unknown = ca.vertcat(*(e.p[PARAMETERS.index(n)] for n in theta))
    known = [e.q, e.w, e.pressures, e.tank, e.p]
    acceleration = ca.SX.sym("a", 3)
    slopes = [ca.vec(ca.jacobian(t, unknown)) for t in (e.momentum, e.force)]
    full = ca.jacobian(ca.vertcat(e.force, e.momentum), ca.vertcat(e.q, e.w, e.pressures, e.p))
    entries = tuple(zip(full.sparsity().row(), full.sparsity().get_col(), strict=True))
    own, levers = ca.diag(ca.jacobian(e.force, e.w)), ca.vertcat(1, e.lever)
    stacked = ca.vertcat(e.force, slopes[1], e.momentum, slopes[0])
    bend = [ca.jacobian(ca.jacobian(e.force, speed), speed) for speed in ca.vertsplit(e.w)]
    rate = ca.jtimes(e.momentum, e.q, e.w) + ca.jtimes(e.momentum, e.w, acceleration)
    return EquationOfMotion(
        theta,
        ca.Function("balance", known, [e.momentum, e.force]),
        ca.Function("slopes", known, slopes),
        ca.Function("gradients", known, [full.nz[:]]),
        entries,
        ca.Function("sway", known, [ca.densify(ca.vec(ca.jacobian(stacked, e.w)))]),
        ca.Function("bend", known, [ca.densify(ca.vertcat(*bend))]),
        ca.Function("pistons", [e.q, e.p], [e.position, e.lever]),
        ca.Function("printed", [e.q, e.w, acceleration, *known[2:]], [e.force - rate, own, levers]),
    )


STOP_MARGIN = 2e-3  # m from the ends of a stroke, beyond which the stops are said to touch


@dataclass(frozen=True)
class SmoothedRecording:
    """One recording, smoothed: arrays (rows, n); `good` (n - bump + 1,) where the filtered equation holds.

    angle_noise, pressure_noise   standard deviation of one sample of each sensor
    touched                       samples left out since a piston was at the end of its stroke
    """

    time: Array
    q: Array
    w: Array
    pressures: Array
    tank: float
    filters: Filters
    good: Mask
    angle_noise: Array
    pressure_noise: Array
    touched: int

    @property
    def known(self) -> tuple[Array, Array, Array, float]:
        """The first arguments of the functions of `motion`."""
        return self.q, self.w, self.pressures, self.tank

    def filtered(self, force: Array, momentum: Array) -> Array:
        """phi * f - phi' * h for rows (k, n), zero where it does not hold."""
        e: Array = apply(self.filters.bump, force) - apply(self.filters.slope, momentum)
        return e * self.good

    @property
    def middle(self) -> slice:
        """The smoothed samples at which the filtered equation stands."""
        half = self.filters.bump.size // 2
        return slice(half, self.q.shape[1] - half)


def angles(recording: Recording) -> Array:
    """The joints' angles without gaps, shape (3, n)."""
    return np.array([interpolated(recording[name]) for name in ANGLES])


def pressures(recording: Recording, needed: Collection[str]) -> Array:
    """The pressures without gaps, shape (6, n); zero for those that are not needed."""
    zero = np.zeros(recording.time.size)
    return np.array([interpolated(recording[n]) if n in needed else zero for n in ALL_PRESSURES])


def samples(
    recording: Recording,
    joints: Sequence[str],
    p: Array,
    window: float = WINDOW,
    every: int = 1,
) -> SmoothedRecording:
    """A recording made ready for the balance of these joints; the rest as in `filters`."""
    kernels = filters(uniform_rate(recording), window, every)
    needed = [n for j in joints for n in PRESSURES[j]]
    if recording.time.size < 2 * kernels.loss + 10:
        raise Problem(
            f"{recording.source}: {recording.time.size} samples, expected {2 * kernels.loss + 10} or more: "
            "the filters take them"
        )
    q, w = (f(angles(recording)) for f in (kernels.smoothed, kernels.slopes))
    smooth = kernels.smoothed(pressures(recording, needed))
    bad = ~good_all(recording, (*ANGLES, *needed))
    position: Array = np.array(motion(()).pistons(q, p)[0].full())
    strokes = np.array([p[PARAMETERS.index(f"manipulator.{j}_stroke")] for j in ("boom", "stick")])[:, None]
    ends: Mask = np.any((position < STOP_MARGIN) | (position > strokes - STOP_MARGIN), axis=0)
    unusable = ~covered(bad, kernels.smooth.size)[::every]
    half = kernels.smooth.size // 2
    good = covered(unusable | ends, kernels.bump.size)
    if not good.any():
        raise Problem(
            f"{recording.source}: expected {2 * kernels.loss * kernels.step / every:.2g} s without a gap or "
            f"clipped sample in {', '.join((*ANGLES, *needed))}, found none"
        )
    return SmoothedRecording(
        time=recording.time[half : recording.time.size - half : every],
        q=q,
        w=w,
        pressures=smooth,
        tank=tank_pressure(recording),
        filters=kernels,
        good=good,
        angle_noise=np.array([noise_sd(recording, n) for n in ANGLES]),
        pressure_noise=np.array([noise_sd(recording, n) if n in needed else 0.0 for n in ALL_PRESSURES]),
        touched=int(ends.sum()),
    )


def numbers(known: Mapping[str, Number]) -> Array:
    """The machine's parameters in the order of `PARAMETERS`."""
    missing = [n for n in PARAMETERS if n not in known]
    if missing:
        raise Problem(f"known parameters: {missing[0]} is missing, expected all of the lumped machine")
    return np.array([known[n].value for n in PARAMETERS])


@dataclass(frozen=True)
class MomentumEquation:
    """e (rows, t) [N.m] at some parameters, E = de/dtheta (m, rows, t); zero where it does not hold."""

    error: Array
    slope: Array

    def moved(self, step: Array) -> MomentumEquation:
        """The same at parameters `step` further; linear in them."""
        return MomentumEquation(self.error + np.einsum("mrt,m->rt", self.slope, step), self.slope)


def equation(s: SmoothedRecording, rows: Sequence[int], theta: tuple[str, ...], p: Array) -> MomentumEquation:
    """The balance of the joints `rows` at the parameters p."""
    f, m, own = motion(theta), len(theta), list(rows)
    momentum, force = (x.full()[own] for x in f.balance(*s.known, p))
    error = s.filtered(force, momentum)
    # (3 m, n) column by column
    by_momentum, by_force = (x.full().reshape(m, 3, -1)[:, own] for x in f.slopes(*s.known, p))
    slope = [s.filtered(a, b) for a, b in zip(by_force, by_momentum, strict=True)]
    return MomentumEquation(error, np.array(slope).reshape(m, *error.shape))
