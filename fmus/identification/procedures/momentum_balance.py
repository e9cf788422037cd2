"""Momentum balance: the machine's equation of motion as a law of `balance`, without accelerations.

Paper eq. (4) as Lagrange's equations, with the energies T and V of the arm:

    dh/dt = f        h = dT/dq'        f = tau + d(T - V)/dq

T, V and tau are those of the manipulator. The torque and the forces of the hydraulics are those of the
machine's drives at measured pressures: `fmus.swing` (motor ports by line resistance and leakage) and
`fmus.boom_stick`, or those of a crane. One Savitzky-Golay filter smooths angles and pressures first; the
speeds are its derivative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fmus.boom_stick import BOOM_STICK
from fmus.components import oil
from fmus.contract import Subsystem, flat, nested, quantities, symbols, unstack, with_derived
from fmus.drives.cylinder import CHAMBERS
from fmus.drives.motor import LINES
from fmus.identification import balance
from fmus.identification.balance import Law, Samples, Solution
from fmus.identification.procedures.experiment_data import noise_sd, parameter_value, tank_pressure
from fmus.identification.recordings.clock import SavitzkyGolay, uniform_rate
from fmus.identification.recordings.masks import good_all
from fmus.joints import JointModel
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
RIPPLE = "force per rate of the command"  # of pressures between samples in step with the command


@dataclass(frozen=True, eq=False)
class MeasuredArm:
    """Mechanics and drives of a machine, and the names of what is measured of them: `part.name`.

    drives        parts whose outputs are the forces and torques of the joints
    manipulator   a subsystem of `fmus.joints`
    """

    drives: tuple[Subsystem, ...]
    manipulator: Subsystem

    @cached_property
    def joints(self) -> dict[str, JointModel]:
        """The joints with a coordinate, by name."""
        return {j.name: j for j in self.manipulator.model.free}

    @cached_property
    def angles(self) -> tuple[str, ...]:
        """The coordinates of the joints."""
        return tuple(f"{self.manipulator.name}.{j.coordinate}" for j in self.joints.values())

    @cached_property
    def pressures(self) -> dict[str, tuple[str, str]]:
        """Of both chambers of each driven joint."""
        found = dict[str, tuple[str, str]]()
        for n, j in self.joints.items():
            for sub in self.drives:
                a, b = (f"{n}_{end}" for end in (LINES if j.motor else CHAMBERS))
                if a in quantities(sub.states):
                    found[n] = f"{sub.name}.{a}", f"{sub.name}.{b}"
        return found

    @cached_property
    def cylinders(self) -> list[str]:
        """The joints with a cylinder."""
        return [n for n, j in self.joints.items() if j.drive]

    @cached_property
    def signals(self) -> dict[str, str]:
        """All of them with their SI units: angles, then pressures."""
        units = [quantities(self.manipulator.states)[n.partition(".")[2]].unit for n in self.angles]
        every = [n for both in self.pressures.values() for n in both]
        return dict(zip(self.angles, units, strict=True)) | dict.fromkeys(every, "Pa")

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Of all parts."""
        parts = (*self.drives, self.manipulator)
        return tuple(f"{sub.name}.{n}" for sub in parts for n in quantities(sub.parameters))

    def damping(self, joint: str) -> str:
        """Parameter of the viscous friction of its piston, or of the joint."""
        own = f"{self.manipulator.name}.{joint}_piston_damping"
        return own if own in self.parameters else own.replace("_piston", "")

    def index(self, joint: str) -> int:
        """Of a joint among all."""
        return [*self.joints].index(joint)

    def vector(self, parameters: Mapping[str, Number]) -> Array:
        """The values of `parameters` in their order."""
        return np.array([parameter_value(parameters, name) for name in self.parameters])

    def parameters_of(self, sub: Subsystem, p: ca.SX) -> Any:
        """Those of a part among all; one that is 0 is derived from the others."""
        rows = [self.parameters.index(f"{sub.name}.{n}") for n in quantities(sub.parameters)]
        return with_derived(sub, unstack(sub.parameters, p[rows]))

    @cached_property
    def equations(self) -> SimpleNamespace:
        """The equations of motion at measured pressures: symbols, and expressions in them.

        q, w, pressures, tank, p   coordinates, speeds, measured pressures, that of the tank, `parameters`
        momentum, force            h and f of the joints, shape (n, 1)
        position, moment_arm       of the pistons of the cylinders, shape (c, 1)
        """
        of_pressures = [n for n in self.signals if n not in self.angles]
        q, w, tank = ca.SX.sym("q", len(self.joints)), ca.SX.sym("w", len(self.joints)), ca.SX.sym("tank")
        pressures, p = ca.SX.sym("pressure", len(of_pressures)), ca.SX.sym("p", len(self.parameters))
        measured = {name.partition(".")[2]: pressures[k] for k, name in enumerate(of_pressures)}
        measured |= {j.coordinate: q[k] for k, j in enumerate(self.joints.values())}
        measured |= {f"{j}_speed": w[k] for k, j in enumerate(self.joints)}
        # the tip's own mass includes what it holds; forces at measured pressures are those at any temperature
        measured |= {"tank_pressure": tank, "held_mass": ca.SX(0), "payload_flow": ca.SX(0)}
        measured["oil_temperature"] = ca.SX(oil.REFERENCE)
        applied = {f"tip_force_{n}": ca.SX(0) for n in "xyz"}
        for sub in self.drives:
            x, u = (at(group, measured) for group in (sub.states, sub.inputs))
            seen = sub.observe(x, u, self.parameters_of(sub, p))
            applied |= {n: x for n, x in flat(seen).items() if n.endswith(("_force", "_torque"))}
        arm = self.manipulator
        of_arm = at(arm.states, measured), at(arm.inputs, applied), self.parameters_of(arm, p)
        seen = flat(arm.observe(*of_arm))
        forces = replace(arm.model, dry=None).forces(*of_arm)  # dry friction is an unknown
        rods = [piston.transmission for piston in forces.pistons.values()]
        kinetic = seen["kinetic_energy"]
        return SimpleNamespace(
            **{"q": q, "w": w, "pressures": pressures, "tank": tank, "p": p},
            momentum=ca.gradient(kinetic, w),
            force=forces.tau + ca.gradient(kinetic - seen["potential_energy"], q),
            position=ca.vertcat(*(r.position for r in rods)),
            moment_arm=ca.vertcat(*(r.arm for r in rods)),
        )

    @cached_property
    def pistons(self) -> ca.Function:
        """(q, p) -> positions and moment arms of the cylinders, each (c, n), of samples in columns."""
        e = self.equations
        return ca.Function("pistons", [e.q, e.p], [e.position, e.moment_arm])


HARVESTER = MeasuredArm((SWING, BOOM_STICK), MANIPULATOR)
JOINTS, ANGLES, PRESSURES = tuple(HARVESTER.joints), HARVESTER.angles, HARVESTER.pressures
SIGNALS, PARAMETERS = HARVESTER.signals, HARVESTER.parameters
ALL_PRESSURES = tuple(n for n in SIGNALS if n not in ANGLES)


def at(group: type[Any], values: Mapping[str, ca.SX]) -> Any:
    """A group at these values, and symbols for its other fields, on which nothing here depends."""
    return nested(group, {**flat(symbols(group)), **values})


@lru_cache(maxsize=16)
def momentum_law(joint: str, theta: tuple[str, ...], arm: MeasuredArm, commanded: bool = False) -> Law:
    """The balance of one joint with parameters theta as unknowns; the constants are p, tank, rounding.

    Further unknowns are a dry friction and a constant force, which act on the speed of the shaft or of the
    piston: tau - J (F_c tanh(x' / rounding) + F_0).

    A command that changes in steps, at each of which a sample is taken, lets the pressures ripple between
    the samples, so that these are no means: with the command as last row of z, F_0 grows with its rate.
    """
    e, row = arm.equations, arm.index(joint)
    unknowns, rounding = {n: ca.SX.sym("u") for n in (*theta, DRY, OFFSET)}, ca.SX.sym("rounding")
    ratio = e.moment_arm[arm.cylinders.index(joint)] if joint in arm.cylinders else ca.SX(1)
    friction = unknowns[DRY] * ca.tanh(ratio * e.w[row] / rounding) + unknowns[OFFSET]
    z = ca.vertcat(e.q, e.w, e.pressures)
    if commanded:
        unknowns[RIPPLE], rate = ca.SX.sym("u"), ca.SX.sym("rate")
        friction, z = friction + unknowns[RIPPLE] * rate, ca.vertcat(z, rate)
    old, new = e.p[[arm.parameters.index(n) for n in theta]], ca.vertcat(*(unknowns[n] for n in theta))
    momentum, force = ca.substitute([e.momentum[row], e.force[row] - ratio * friction], [old], [new])
    known = ca.vertcat(e.p, e.tank, rounding)
    return balance.law(z, unknowns, known, force, momentum)


def speed_ratio(joint: str, q: Array, p: Array, arm: MeasuredArm = HARVESTER) -> Array:
    """x' over the joint's speed at coordinates q (joints or more, n): 1 or the moment arm [m], shape (n,)."""
    if joint not in arm.cylinders:
        return np.ones(q.shape[1])
    moment_arms: Array = np.array(arm.pistons(q[: len(arm.joints)], p)[1].full())
    return np.array(moment_arms[arm.cylinders.index(joint)])


def needed_signals(joint: str, arm: MeasuredArm = HARVESTER) -> tuple[str, ...]:
    """The angles, and the pressures of this joint."""
    return (*arm.angles, *arm.pressures[joint])


def filtered(
    recording: Recording, joint: str, kernel: SavitzkyGolay, arm: MeasuredArm = HARVESTER
) -> tuple[Array, list[tuple[int, Array]], Array, Mask]:
    """The signals that the balance of a joint needs, through a filter: N samples, n filtered ones.

    Samples without gaps, zero of pressures that are not needed, (k, N); sensor and filter of each row of z;
    z: angles, speeds, pressures; whether all samples under the filter are good, (n,).
    """
    names, none = needed_signals(joint, arm), np.zeros(recording.time.size)
    raw = np.array([recording.interpolated(n) if n in names else none for n in arm.signals])
    value, derivative, _ = kernel.weights
    channels = [(k, weights) for weights in (value, derivative) for k in range(len(arm.joints))]
    channels += [(k, value) for k in range(len(arm.joints), len(raw))]
    z = np.array([np.correlate(raw[k], weights, "valid") for k, weights in channels])
    good: Mask = np.asarray(sliding_window_view(good_all(recording, names), kernel.size).all(axis=1))
    return raw, channels, z, good


def smoothing(recording: Recording, window: float = WINDOW) -> tuple[SavitzkyGolay, dict[str, Any]]:
    """The filter of all signals; rate, bump and slope of `Samples`, the bump of some length [s].

    Raises Problem if the recording is too short.
    """
    rate = uniform_rate(recording)
    kernel = SavitzkyGolay(rate, max(SMOOTHING, (ORDER + 2) / rate), ORDER)
    half = max(round(window * rate / 2), 2) + 1
    if (count := recording.time.size) < (shortest := 2 * half + kernel.size):
        raise Problem(f"{recording.source}: {count} samples, expected {shortest} or more for the filters")
    bump, slope = balance.modulating_function(half, rate)
    return kernel, {"rate": rate, "bump": bump, "slope": slope}


def joint_samples(
    recording: Recording,
    joint: str,
    theta: tuple[str, ...],
    p: Array,
    *,
    window: float = WINDOW,
    slow: float = 0.0,
    rounding: float = 1.0,
    arm: MeasuredArm = HARVESTER,
    command: str = "",
) -> Samples:
    """A recording for the balance of one joint.

    window     length of the bump [s], longer if the sampling rate requires it
    slow       rms speeds below which a sample is left out
    rounding   rms speeds over which the sign of the dry friction is rounded
    command    of the joint, for the further unknown `RIPPLE`; "" without it
    """
    kernel, windows = smoothing(recording, window)
    size = windows["bump"].size
    raw, channels, z, good = filtered(recording, joint, kernel, arm)
    used, count = needed_signals(joint, arm), len(arm.joints)
    strokes = np.array([p[arm.parameters.index(f"manipulator.{j}_stroke")] for j in arm.cylinders])[:, None]
    position: Array = np.array(arm.pistons(z[:count], p)[0].full())
    good &= np.all((position >= STOP_MARGIN) & (position <= strokes - STOP_MARGIN), axis=0)
    speed = speed_ratio(joint, z, p, arm) * z[count + arm.index(joint)]
    rms = float(np.sqrt(np.mean(speed**2)))
    if not balance.window_starts(good, size).size:
        shortest = f"{(size + 1 + kernel.size) / windows['rate']:.2g} s"
        expected = f"expected {shortest} without a gap or clipped sample in {', '.join(used)}"
        raise Problem(f"{recording.source}: {expected}, got no such stretch")
    noise = np.array([noise_sd(recording, n) if n in used else 0.0 for n in arm.signals])
    known, sensors = [*p, tank_pressure(recording), max(rounding * rms, 1e-9)], [*arm.signals]
    if command:
        channels.append((len(raw), kernel.weights[1]))
        raw, noise = np.vstack([raw, recording.interpolated(command)]), np.append(noise, 0.0)
        sensors.append(command)
    return replace(
        balance.samples_of(momentum_law(joint, theta, arm, bool(command)), sensors, raw, noise, known),
        **windows,
        channels=channels,
        starts=balance.window_starts(good & (np.abs(speed) >= slow * rms), size),
    )


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
