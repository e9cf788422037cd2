"""Momentum balance: the machine's equation of motion as a law of `balance`, without accelerations.

Paper eq. (4) as Lagrange's equations, with the energies T and V of the arm:

    dh/dt = f        h = dT/dq'        f = tau + d(T - V)/dq

T, V and tau are those of `fmus.manipulator`. The torque and the forces of the hydraulics are those of
`fmus.swing` (motor ports by line resistance and leakage) and `fmus.boom_stick`, at measured pressures. One
Savitzky-Golay filter smooths angles and pressures first; the speeds are its derivative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fmus.boom_stick import BOOM_STICK
from fmus.components import oil
from fmus.contract import Subsystem, flat, nested, quantities, symbols, unstack, with_derived
from fmus.identification import balance
from fmus.identification.balance import Law, Samples, Solution
from fmus.identification.procedures.experiment_data import noise_sd, parameter_value, tank_pressure
from fmus.identification.recordings.clock import SavitzkyGolay, uniform_rate
from fmus.identification.recordings.masks import good_all
from fmus.manipulator import MANIPULATOR
from fmus.parameters import Number
from fmus.swing import SWING
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording
from orchestrator.data.table import Array

SMOOTHING = 0.06  # s, length of the smoothing filter: flat up to 15 Hz, far above the modes of the arm
ORDER = 4  # degree of its polynomials
WINDOW = 0.3  # s, length of the bump
STOP_MARGIN = 2e-3  # m from the ends of a stroke within which the end stops may act
MAX_NAMES = 3  # parameters named in a remark
EXACT = "manipulator.gravity"  # has no error
DRY, OFFSET = "dry friction", "constant force"  # further unknowns of the balance of one joint
JOINTS = ("swing", "boom", "stick")
ANGLES = tuple(f"manipulator.{j}_angle" for j in JOINTS)
PRESSURES = {
    "swing": ("swing.swing_pressure_a", "swing.swing_pressure_b"),
    "boom": ("boom_stick.boom_head_pressure", "boom_stick.boom_rod_pressure"),
    "stick": ("boom_stick.stick_head_pressure", "boom_stick.stick_rod_pressure"),
}
ALL_PRESSURES = tuple(name for both in PRESSURES.values() for name in both)
SIGNALS = dict.fromkeys(ANGLES, "rad") | dict.fromkeys(ALL_PRESSURES, "Pa")
_PARTS = (SWING, BOOM_STICK, MANIPULATOR)
PARAMETERS = tuple(f"{sub.name}.{n}" for sub in _PARTS for n in quantities(sub.parameters))


@lru_cache(maxsize=1)
def symbolic_equations() -> SimpleNamespace:
    """The equations of motion at measured pressures: symbols, and expressions in them.

    q, w, pressures, tank, p   angles, speeds, measured pressures, that of the tank, parameters of the machine
    momentum, force            h and f of the joints, shape (3, 1)
    position, moment_arm       of the pistons of boom and stick, shape (2, 1)
    """
    q, w, tank = ca.SX.sym("q", 3), ca.SX.sym("w", 3), ca.SX.sym("tank")
    pressures, p = ca.SX.sym("pressure", len(ALL_PRESSURES)), ca.SX.sym("p", len(PARAMETERS))
    measured = {name.partition(".")[2]: pressures[k] for k, name in enumerate(ALL_PRESSURES)}
    measured |= {f"{j}_angle": q[k] for k, j in enumerate(JOINTS)}
    measured |= {f"{j}_speed": w[k] for k, j in enumerate(JOINTS)}
    # the head's own mass includes what it holds; forces at measured pressures are those at any temperature
    measured |= {"tank_pressure": tank, "held_mass": ca.SX(0), "payload_flow": ca.SX(0)}
    measured["oil_temperature"] = ca.SX(oil.REFERENCE)
    swing, cylinders = (
        sub.observe(_at(sub.states, measured), _at(sub.inputs, measured), _parameters_of(sub, p))
        for sub in (SWING, BOOM_STICK)
    )
    applied = {"swing_torque": swing.swing_torque}
    applied |= {n: getattr(cylinders, n) for n in ("boom_force", "stick_force")}
    of_arm = (
        _at(MANIPULATOR.states, measured),
        _at(MANIPULATOR.inputs, applied),
        _parameters_of(MANIPULATOR, p),
    )
    seen, forces = MANIPULATOR.observe(*of_arm), MANIPULATOR.model.forces(*of_arm)
    rods = [piston.transmission for piston in forces.pistons.values()]
    return SimpleNamespace(
        **{"q": q, "w": w, "pressures": pressures, "tank": tank, "p": p},
        momentum=ca.gradient(seen.kinetic_energy, w),
        force=forces.tau + ca.gradient(seen.kinetic_energy - seen.potential_energy, q),
        position=ca.vertcat(*(r.position for r in rods)),
        moment_arm=ca.vertcat(*(r.arm for r in rods)),
    )


def _at(group: type[Any], values: Mapping[str, ca.SX]) -> Any:
    """A group at these values, and symbols for its other fields, on which nothing here depends."""
    return nested(group, {**flat(symbols(group)), **values})


def _parameters_of(sub: Subsystem, p: ca.SX) -> Any:
    """The parameters of a subsystem among those of the machine; one that is 0 is derived from the others."""
    rows = [PARAMETERS.index(f"{sub.name}.{n}") for n in quantities(sub.parameters)]
    return with_derived(sub, unstack(sub.parameters, p[rows]))


@lru_cache(maxsize=16)
def momentum_law(joint: str, theta: tuple[str, ...]) -> Law:
    """The balance of one joint with parameters theta as unknowns; the constants are p, tank, rounding.

    Further unknowns are a dry friction and a constant force, which act on the speed of the swing or of the
    piston: tau - J (F_c tanh(x' / rounding) + F_0).
    """
    e, row = symbolic_equations(), JOINTS.index(joint)
    unknowns, rounding = {n: ca.SX.sym("u") for n in (*theta, DRY, OFFSET)}, ca.SX.sym("rounding")
    ratio = ca.vertcat(1, e.moment_arm)[row]
    friction = unknowns[DRY] * ca.tanh(ratio * e.w[row] / rounding) + unknowns[OFFSET]
    old, new = e.p[[PARAMETERS.index(n) for n in theta]], ca.vertcat(*(unknowns[n] for n in theta))
    momentum, force = ca.substitute([e.momentum[row], e.force[row] - ratio * friction], [old], [new])
    known = ca.vertcat(e.p, e.tank, rounding)
    return balance.law(ca.vertcat(e.q, e.w, e.pressures), unknowns, known, force, momentum)


@lru_cache(maxsize=1)
def pistons() -> ca.Function:
    """(q, p) -> positions and moment arms of boom and stick, each (2, n), of samples in columns."""
    e = symbolic_equations()
    return ca.Function("pistons", [e.q, e.p], [e.position, e.moment_arm])


def speed_ratio(joint: str, q: Array, p: Array) -> Array:
    """x' over the joint's speed at angles q (3 or more, n): 1 or the moment arm [m], shape (n,)."""
    if joint == "swing":
        return np.ones(q.shape[1])
    moment_arms: Array = np.array(pistons()(q[:3], p)[1].full())
    return np.array(moment_arms[JOINTS.index(joint) - 1])


def needed_signals(joint: str) -> tuple[str, ...]:
    """The angles, and the pressures of this joint."""
    return (*ANGLES, *PRESSURES[joint])


def filtered(
    recording: Recording, joint: str, kernel: SavitzkyGolay
) -> tuple[Array, list[tuple[int, Array]], Array, Mask]:
    """The signals that the balance of a joint needs, through a filter: N samples, n filtered ones.

    Samples without gaps, zero of pressures that are not needed, (9, N); sensor and filter of each row of z;
    z: angles, speeds, pressures, (12, n); whether all samples under the filter are good, (n,).
    """
    names, none = needed_signals(joint), np.zeros(recording.time.size)
    raw = np.array([recording.interpolated(n) if n in names else none for n in SIGNALS])
    value, derivative, _ = kernel.weights
    channels = [(k, weights) for weights in (value, derivative) for k in range(3)]
    channels += [(k, value) for k in range(3, len(raw))]
    z = np.array([np.correlate(raw[k], weights, "valid") for k, weights in channels])
    good: Mask = np.asarray(sliding_window_view(good_all(recording, names), kernel.size).all(axis=1))
    return raw, channels, z, good


def joint_samples(
    recording: Recording,
    joint: str,
    theta: tuple[str, ...],
    p: Array,
    *,
    window: float = WINDOW,
    slow: float = 0.0,
    rounding: float = 1.0,
) -> Samples:
    """A recording for the balance of one joint.

    window     length of the bump [s], longer if the sampling rate requires it
    slow       rms speeds below which a sample is left out
    rounding   rms speeds over which the sign of the dry friction is rounded
    """
    rate = uniform_rate(recording)
    kernel = SavitzkyGolay(rate, max(SMOOTHING, (ORDER + 2) / rate), ORDER)
    half = max(round(window * rate / 2), 2) + 1
    bump, slope = balance.modulating_function(half, rate)
    shortest = 2 * half + kernel.size
    if recording.time.size < shortest:
        raise Problem(
            f"{recording.source}: {recording.time.size} samples, expected {shortest} or more for the filters"
        )
    raw, channels, z, good = filtered(recording, joint, kernel)
    used = needed_signals(joint)
    strokes = np.array([p[PARAMETERS.index(f"manipulator.{j}_stroke")] for j in ("boom", "stick")])[:, None]
    position: Array = np.array(pistons()(z[:3], p)[0].full())
    good &= np.all((position >= STOP_MARGIN) & (position <= strokes - STOP_MARGIN), axis=0)
    speed = speed_ratio(joint, z, p) * z[3 + JOINTS.index(joint)]
    rms = float(np.sqrt(np.mean(speed**2)))
    if not balance.window_starts(good, bump.size).size:
        raise Problem(
            f"{recording.source}: expected {shortest / rate:.2g} s without a gap or "
            f"clipped sample in {', '.join(used)}, got no such stretch"
        )
    noise = np.array([noise_sd(recording, n) if n in used else 0.0 for n in SIGNALS])
    known = [*p, tank_pressure(recording), max(rounding * rms, 1e-9)]
    return replace(
        balance.samples_of(momentum_law(joint, theta), SIGNALS, raw, noise, known),
        channels=channels,
        rate=rate,
        bump=bump,
        slope=slope,
        starts=balance.window_starts(good & (np.abs(speed) >= slow * rms), bump.size),
    )


def parameter_vector(parameters: Mapping[str, Number]) -> Array:
    """The machine's parameters in the order of `PARAMETERS`."""
    return np.array([parameter_value(parameters, name) for name in PARAMETERS])


@dataclass(frozen=True)
class KnownParameterEffect:
    """Effect of errors of the known parameters on an estimated parameter.

    total     standard deviation by the recordings and by the known parameters, which are independent
    note      addition to the note in parameters.toml; empty unless the known parameters widen the interval
    remarks   sentences that follow the parameter's name and a colon
    """

    total: float
    note: str
    remarks: tuple[str, ...]


def known_parameter_effect(
    solution: Solution, parameters: Mapping[str, Number], name: str
) -> KnownParameterEffect:
    """Effect of the known parameters on an estimated parameter of a momentum balance."""
    known = {n: parameters[n] for n in PARAMETERS if n not in solution.fit.names and n != EXACT}
    row = solution.by_known()[solution.fit.names.index(name)]
    by_known = dict(zip(PARAMETERS, map(float, row), strict=False))
    # by one standard deviation of each known parameter, by 1 % of one without
    by_sd = {n: by_known[n] * x.sd for n, x in known.items() if x.sd is not None}
    by_percent = {n: by_known[n] * abs(x.value) / 100 for n, x in known.items() if x.sd is None}
    own, unit, note, remarks = solution.fit.sd(name), parameters[name].unit, "", list[str]()
    sd = math.sqrt(sum(x**2 for x in by_sd.values()))
    total = math.hypot(own, sd)
    if sd > balance.NEGLIGIBLE * own:
        note = f"; sd {own:.2g} by the recordings, {sd:.2g} by the known parameters"
        largest = _largest({n: x for n, x in by_sd.items() if x**2 > balance.NEGLIGIBLE * sd**2})
        remarks.append(
            f"the uncertainty of the known parameters adds a standard deviation of {sd:.2g} {unit} to "
            f"the {own:.2g} {unit} from the recordings; most of it comes from {', '.join(largest)}."
        )
    if large := _largest({n: x for n, x in by_percent.items() if abs(x) > total}):
        changes = ", ".join(f"{n} {100 * by_percent[n] / solution.fit[name]:+.2g} %" for n in large)
        remarks.append(
            "the interval assumes exact geometry and masses. An error of 1 % would change the "
            f"value: {changes}."
        )
    return KnownParameterEffect(total, note, tuple(remarks))


def _largest(changes: Mapping[str, float]) -> list[str]:
    # rounding errors do not decide between equal changes
    return sorted(changes, key=lambda n: -float(f"{abs(changes[n]):.9g}"))[:MAX_NAMES]
