"""Momentum balance: the machine's equation of motion, filtered so that no acceleration is needed.

Paper eq. (4) in terms of the generalised momenta h = M(q) q':

    dh/dt = f        f = tau + dT/dq - G        dT/dq = dM/dt q' - V

M, V, G and tau are those of `fmus.manipulator`. The torque and the forces of the hydraulics are those of
`fmus.swing` (motor ports by line resistance and leakage) and `fmus.boom_stick`, at measured pressures.
The equation is multiplied by a smooth bump phi of compact support and integrated by parts (Shinbrot 1957,
modulating functions):

    int phi'(t - s) h(s) ds = int phi(t - s) f(s) ds        at every t, e = phi * f - phi' * h

Both sides have the same filter. h and f are functions of angles, speeds and pressures, which one
Savitzky-Golay filter smooths first; the speeds are its derivative. All these operations are linear to first
order in the noise of the sensors, so the transposed filters give the sensitivity to each sample.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem, quantities, symbolic, symbols
from fmus.identification.procedures.experiment_data import (
    interpolated,
    noise_sd,
    parameter_value,
    tank_pressure,
)
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
from orchestrator.data.recording import Mask, Recording
from orchestrator.data.table import Array

SMOOTHING = 0.06  # s, length of the smoothing filter: flat up to 15 Hz, far above the modes of the arm
ORDER = 4  # degree of its polynomials
WINDOW = 0.3  # s, length of the bump


@dataclass(frozen=True)
class Filters:
    """Kernels of odd length, in the order of convolution.

    step           time between two smoothed samples [s]
    every          samples of the recording per smoothed sample
    smooth, rate   Savitzky-Golay value and derivative, over the samples of the recording
    bump, slope    phi dt, whose sum is 1, and phi' dt, whose first moment is 1, over the smoothed samples
    """

    step: float
    every: int
    smooth: Array
    rate: Array
    bump: Array
    slope: Array

    @property
    def loss(self) -> int:
        """Number of samples without a result at each end of the recording."""
        return self.smooth.size // 2 + self.bump.size // 2 * self.every

    @property
    def correlation_lags(self) -> int:
        """Lags, in smoothed samples, over which filtered residuals are correlated: four times the filters."""
        return 8 * self.loss // self.every

    def gain(self, kernel: Array) -> float:
        """Standard deviation of a speed filtered by `kernel`, over that of a sample of the angle [1/s]."""
        return float(np.linalg.norm(np.convolve(self.rate, upsampled(kernel, self.every))))

    def values(self, rows: Array) -> Array:
        """Smoothed values of signals (k, n), except at the ends."""
        return convolve(self.smooth, rows)[:, :: self.every]

    def rates(self, rows: Array) -> Array:
        """Smoothed time derivatives of signals (k, n), except at the ends."""
        return convolve(self.rate, rows)[:, :: self.every]

    def transposed(self, by_value: Array, by_rate: Array | None = None) -> Array:
        """Gradient with respect to the samples from those with respect to smoothed values and rates."""
        gradient = transposed_convolve(self.smooth, upsampled(by_value, self.every))
        if by_rate is None:
            return gradient
        return gradient + transposed_convolve(self.rate, upsampled(by_rate, self.every))


def filters(rate: float, window: float = WINDOW, every: int = 1) -> Filters:
    """The kernels for a sampling rate [Hz]; the window [s] is longer if the rate requires it."""
    savitzky_golay = SavitzkyGolay(rate, max(SMOOTHING, (ORDER + 2) / rate), ORDER)
    step, half = every / rate, max(round(window * rate / every / 2), 2)
    bump, slope = modulating_function(half + 1)
    value, derivative = (savitzky_golay.weights[order][::-1] for order in (0, 1))
    return Filters(step, every, value, derivative, bump / bump.sum(), -slope / (bump.sum() * step))


def convolve(kernel: Array, rows: Array) -> Array:
    """Each row (k, n) convolved with a kernel, except at the ends."""
    return np.array([np.convolve(row, kernel, "valid") for row in rows])


def transposed_convolve(kernel: Array, rows: Array) -> Array:
    """The transpose of `convolve`."""
    return np.array([np.convolve(row, kernel[::-1], "full") for row in rows])


def upsampled(rows: Array, every: int) -> Array:
    """Rows with zeros between the samples: the transpose of keeping each `every`-th sample."""
    full = np.zeros((*rows.shape[:-1], (rows.shape[-1] - 1) * every + 1))
    full[..., ::every] = rows
    return full


def all_good(good: Mask, width: int) -> Mask:
    """Whether all samples under a kernel of `width` samples are good, shape (n - width + 1,)."""
    return np.convolve(~good, np.ones(width), "valid") < 0.5


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

    balance          -> h, f, each (3, n)
    jacobians        -> dh/dtheta, df/dtheta, each (3 m, n), column by column
    gradients        -> nonzero entries of d(f, h)/d(q, q', pressures, parameters), (entries, n)
    entries          row (0 to 5) and column of each of these entries
    speed_jacobian   -> d(f, df/dtheta.., h, dh/dtheta..)/dq', (3 * 2 * (1 + m) * 3, n), the speed slowest
    speed_hessian    -> d2f/dq_k'^2, (3 * 3, n), the speed k slowest
    pistons          (q, parameters) -> positions and moment arms of boom and stick, each (2, n)
    printed          (q, q', q'', ...) -> f - dh/dt as in (13), df_i/dq_i', x_i'/q_i', each (3, n)
    """

    theta: tuple[str, ...]
    balance: ca.Function
    jacobians: ca.Function
    gradients: ca.Function
    entries: tuple[tuple[int, int], ...]
    speed_jacobian: ca.Function
    speed_hessian: ca.Function
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
    moment_arm: ca.SX


@lru_cache(maxsize=1)
def _symbolic_equations() -> _Symbols:
    q, w = ca.SX.sym("q", 3), ca.SX.sym("w", 3)
    pressures, tank = ca.SX.sym("pressure", len(ALL_PRESSURES)), ca.SX.sym("tank")
    p = ca.SX.sym("p", len(PARAMETERS))
    x, own_p, u = symbols(MANIPULATOR.states), symbols(MANIPULATOR.parameters), symbols(ManipulatorInputs)
    measured = dict(zip(ALL_PRESSURES, ca.vertsplit(pressures), strict=True)) | {"swing.swing_speed": w[0]}
    outputs = ((SWING, "swing_torque"), (BOOM_STICK, "boom_force"), (BOOM_STICK, "stick_force"))
    hydraulics = [_output_at(sub, name, measured, tank, p) for sub, name in outputs]
    mechanics, rods = arm.mechanics(x, own_p, POINT_MASS), arm.pistons(x, own_p)
    terms = [mechanics.mass, mechanics.coriolis, mechanics.gravity, forces(_LUMPED, x, u, own_p)]
    terms += [ca.vertcat(*(r.position for r in rods)), ca.vertcat(*(r.triangle.arm for r in rods))]
    coordinates = [getattr(x, f"{j}_{order}") for order in ("angle", "speed") for j in JOINTS]
    applied = [u.swing_torque, u.boom_force, u.stick_force]
    empty = [x.held_mass, x.payload_flow]  # the head's own mass includes what it holds
    old = ca.vertcat(*coordinates, *empty, *applied, *vars(own_p).values())
    new = ca.vertcat(q, w, 0, 0, *hydraulics, *_parameters_of(MANIPULATOR, p))
    mass, coriolis, gravity, tau, position, moment_arm = ca.substitute(terms, [old], [new])
    momentum = mass @ w
    force = tau + ca.jtimes(momentum, q, w) - coriolis - gravity
    return _Symbols(q, w, pressures, tank, p, momentum, force, position, moment_arm)


def _parameters_of(sub: Subsystem, p: ca.SX) -> list[ca.SX]:
    """The parameters of a subsystem among those of the machine."""
    return [p[PARAMETERS.index(f"{sub.name}.{n}")] for n in quantities(sub.parameters)]


def _output_at(sub: Subsystem, name: str, measured: dict[str, Any], tank: ca.SX, p: ca.SX) -> ca.SX:
    """An output of a drive at measured pressures; it must not depend on other states and inputs."""
    model, values = symbolic(sub), measured | {f"{sub.name}.tank_pressure": tank}
    declared = [
        (f"{sub.name}.{n}", s)
        for group, column in ((sub.states, model.x), (sub.inputs, model.u))
        for n, s in zip(quantities(group), ca.vertsplit(column), strict=True)
    ]
    old = [s for n, s in declared if n in values]
    new = [values[n] for n, _ in declared if n in values]
    output = model.y[list(quantities(sub.outputs)).index(name)]
    return ca.substitute(output, ca.vertcat(*old, model.p), ca.vertcat(*new, *_parameters_of(sub, p)))


@lru_cache(maxsize=8)
def equation_of_motion(theta: tuple[str, ...]) -> EquationOfMotion:
    """The functions, with derivatives with respect to the parameters theta."""
    e = _symbolic_equations()
    unknown = ca.vertcat(*(e.p[PARAMETERS.index(n)] for n in theta))
    arguments = [e.q, e.w, e.pressures, e.tank, e.p]
    acceleration = ca.SX.sym("a", 3)
    jacobians = [ca.vec(ca.jacobian(t, unknown)) for t in (e.momentum, e.force)]
    gradients = ca.jacobian(ca.vertcat(e.force, e.momentum), ca.vertcat(e.q, e.w, e.pressures, e.p))
    entries = tuple(zip(gradients.sparsity().row(), gradients.sparsity().get_col(), strict=True))
    damping, speed_ratio = ca.diag(ca.jacobian(e.force, e.w)), ca.vertcat(1, e.moment_arm)
    stacked = ca.vertcat(e.force, jacobians[1], e.momentum, jacobians[0])
    hessian = [ca.jacobian(ca.jacobian(e.force, speed), speed) for speed in ca.vertsplit(e.w)]
    rate = ca.jtimes(e.momentum, e.q, e.w) + ca.jtimes(e.momentum, e.w, acceleration)
    printed = [e.force - rate, damping, speed_ratio]
    return EquationOfMotion(
        theta,
        ca.Function("balance", arguments, [e.momentum, e.force]),
        ca.Function("jacobians", arguments, jacobians),
        ca.Function("gradients", arguments, [gradients.nz[:]]),
        entries,
        ca.Function("speed_jacobian", arguments, [ca.densify(ca.vec(ca.jacobian(stacked, e.w)))]),
        ca.Function("speed_hessian", arguments, [ca.densify(ca.vertcat(*hessian))]),
        ca.Function("pistons", [e.q, e.p], [e.position, e.moment_arm]),
        ca.Function("printed", [e.q, e.w, acceleration, *arguments[2:]], printed),
    )


STOP_MARGIN = 2e-3  # m from the ends of a stroke within which the end stops may act


@dataclass(frozen=True)
class SmoothedRecording:
    """A recording, smoothed for the momentum balance; signals have shape (rows, n).

    tank                          tank pressure [Pa]
    good                          whether the filtered equation is valid, shape (n - bump + 1,)
    angle_noise, pressure_noise   standard deviation of a sample of each sensor
    at_stroke_end                 number of samples left out because a piston was at the end of its stroke
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
    at_stroke_end: int

    @property
    def arguments(self) -> tuple[Array, Array, Array, float]:
        """Arguments of the functions of `EquationOfMotion`, except the parameters."""
        return self.q, self.w, self.pressures, self.tank

    def filtered(self, force: Array, momentum: Array) -> Array:
        """phi * f - phi' * h for rows (k, n); zero if the equation is not valid."""
        e: Array = convolve(self.filters.bump, force) - convolve(self.filters.slope, momentum)
        return e * self.good

    @property
    def centres(self) -> slice:
        """Smoothed samples at the centres of the bumps, one per value of the filtered equation."""
        half = self.filters.bump.size // 2
        return slice(half, self.q.shape[1] - half)


def angles(recording: Recording) -> Array:
    """The joint angles without gaps, shape (3, n)."""
    return np.array([interpolated(recording[name]) for name in ANGLES])


def pressures(recording: Recording, needed: Collection[str]) -> Array:
    """The pressures without gaps, shape (6, n); zero for those that are not needed."""
    zero = np.zeros(recording.time.size)
    return np.array([interpolated(recording[n]) if n in needed else zero for n in ALL_PRESSURES])


def smoothed_recording(
    recording: Recording, joints: Sequence[str], p: Array, window: float = WINDOW, every: int = 1
) -> SmoothedRecording:
    """A recording, smoothed for the balance of these joints; window and every as in `filters`."""
    kernels = filters(uniform_rate(recording), window, every)
    needed = [n for j in joints for n in PRESSURES[j]]
    if recording.time.size < 2 * kernels.loss + 10:
        raise Problem(
            f"{recording.source}: {recording.time.size} samples, expected {2 * kernels.loss + 10} or more "
            "for the filters"
        )
    raw_angles = angles(recording)
    q, w = kernels.values(raw_angles), kernels.rates(raw_angles)
    strokes = np.array([p[PARAMETERS.index(f"manipulator.{j}_stroke")] for j in ("boom", "stick")])[:, None]
    position: Array = np.array(equation_of_motion(()).pistons(q, p)[0].full())
    at_end: Mask = np.any((position < STOP_MARGIN) | (position > strokes - STOP_MARGIN), axis=0)
    smoothed_good = all_good(good_all(recording, (*ANGLES, *needed)), kernels.smooth.size)[::every]
    good = all_good(smoothed_good & ~at_end, kernels.bump.size)
    if not good.any():
        raise Problem(
            f"{recording.source}: expected {2 * kernels.loss * kernels.step / every:.2g} s without a gap or "
            f"clipped sample in {', '.join((*ANGLES, *needed))}, got no such stretch"
        )
    half = kernels.smooth.size // 2
    return SmoothedRecording(
        time=recording.time[half : recording.time.size - half : every],
        q=q,
        w=w,
        pressures=kernels.values(pressures(recording, needed)),
        tank=tank_pressure(recording),
        filters=kernels,
        good=good,
        angle_noise=np.array([noise_sd(recording, n) for n in ANGLES]),
        pressure_noise=np.array([noise_sd(recording, n) if n in needed else 0.0 for n in ALL_PRESSURES]),
        at_stroke_end=int(at_end.sum()),
    )


def parameter_vector(parameters: Mapping[str, Number]) -> Array:
    """The machine's parameters in the order of `PARAMETERS`."""
    return np.array([parameter_value(parameters, name) for name in PARAMETERS])


@dataclass(frozen=True)
class MomentumEquation:
    """Residual e (rows, t) [N.m] at some parameters and its Jacobian de/dtheta (m, rows, t).

    Both are zero if the equation is not valid.
    """

    residual: Array
    jacobian: Array

    def shifted(self, step: Array) -> MomentumEquation:
        """The equation at the parameters plus `step`; it is linear in them."""
        return MomentumEquation(self.residual + np.einsum("mrt,m->rt", self.jacobian, step), self.jacobian)


def momentum_equation(
    s: SmoothedRecording, rows: Sequence[int], theta: tuple[str, ...], p: Array
) -> MomentumEquation:
    """The filtered balance of the joints with indices `rows` at the parameters p."""
    f, m, joints = equation_of_motion(theta), len(theta), list(rows)
    momentum, force = (x.full()[joints] for x in f.balance(*s.arguments, p))
    residual = s.filtered(force, momentum)
    # (3 m, n) column by column
    by_momentum, by_force = (x.full().reshape(m, 3, -1)[:, joints] for x in f.jacobians(*s.arguments, p))
    jacobian = [s.filtered(df, dh) for df, dh in zip(by_force, by_momentum, strict=True)]
    return MomentumEquation(residual, np.array(jacobian).reshape(m, *residual.shape))
