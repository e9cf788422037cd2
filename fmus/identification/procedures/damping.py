"""Damping procedure (section 4(d), eq. (13), Fig. 9): viscous damping of the swing gear and the pistons.

    x' B = a        a = tau - M q'' - V - G        x' = q' of the swing, J q' of a piston

tau is that of measured pressures; M, V, G are those of the manipulator, with the known viscous friction of
the joints. B is the unknown of the momentum balance (`momentum_balance`), without accelerations.

Validity: viscous friction, all other parameters known. A dry friction is a further unknown if it is clear. B
absorbs all other effects, as the paper notes; the remarks quantify them.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.identification import balance
from fmus.identification.balance import Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.recordings.reading import require
from fmus.identification.results import Curve, Estimate, Finding, Panel, ProcedureResult
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

SIGNALS: Mapping[str, str] = momentum.SIGNALS  # of the pressures only those of the joint are needed
SIGN_ROUNDING = 0.003  # rms speeds over which the sign of a dry friction is rounded; 0.03 biases B by 4 %
MOVING = 3.0  # standard deviations of its noise above which a root mean square speed is a motion
SLOWEST = 1e-6  # rad/s: a smaller speed is a rounding error
MAX_POINTS = 1500  # points drawn
CLEAR = 4.0  # standard deviations above which a dry friction is reported, and estimated together with B


@dataclass(frozen=True)
class FrictionContact:
    """Location of a viscous friction: its parameter, and labels and units of speed and resistance."""

    joint: str
    parameter: str
    unit: str
    speed: tuple[str, str]
    resistance: tuple[str, str]

    @property
    def theta(self) -> str:
        """Name of the parameter with its part."""
        return f"manipulator.{self.parameter}"


BY_JOINT = {
    joint: FrictionContact(joint, f"{joint}_{parameter}", unit, (speed, speed_unit), (resistance, force_unit))
    for joint, parameter, unit, speed, speed_unit, resistance, force_unit in (
        ("swing", "damping", "N.m.s/rad", "swing speed", "rad/s", "torque of the gear's friction", "N.m"),
        ("boom", "piston_damping", "N.s/m", "speed of the boom piston", "m/s", "force of its friction", "N"),
        (
            "stick",
            "piston_damping",
            "N.s/m",
            "speed of the stick piston",
            "m/s",
            "force of its friction",
            "N",
        ),
    )
}


@dataclass(frozen=True)
class JointDamping:
    """Damping of one joint, estimated from its recordings.

    speed, resistance   x' and a of (13), filtered, shape (n,)
    known_effect        effect of errors of the known parameters
    dry, dry_sd         dry friction: tested, or estimated with B if it is clear
    at_rest             names of files in which the joint does not move, which are left out
    """

    contact: FrictionContact
    records: Sequence[momentum.JointRecording]
    solution: Solution
    speed: Array
    resistance: Array
    known_effect: momentum.KnownParameterEffect
    dry: float
    dry_sd: float
    at_rest: tuple[str, ...]

    @property
    def value(self) -> float:
        """B."""
        return float(self.solution.fit.values[0])

    @property
    def sd(self) -> float:
        """Standard deviation by the recordings."""
        return self.solution.fit.sd(self.contact.theta)


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """B of each joint that has recordings."""
    by_joint: dict[str, list[Recording]] = {joint: [] for joint in BY_JOINT}
    for recording in data.training_recordings(recordings, "damping", dict.fromkeys(momentum.ANGLES, "rad")):
        joint = data.condition(recording, "joint", BY_JOINT)
        require(recording, dict.fromkeys(momentum.PRESSURES[joint], "Pa"))
        by_joint[joint].append(recording)
    joints = [joint_damping(BY_JOINT[j], r, parameters) for j, r in by_joint.items() if r]
    return ProcedureResult(
        procedure="damping",
        title="Viscous damping of the joints: resistance over speed",
        figure=9,
        estimates=tuple(
            Estimate.normal(
                joint.contact.parameter,
                joint.value,
                joint.contact.unit,
                joint.known_effect.total,
                f"eq. (13) by impulses and momenta{joint.known_effect.note}",
                minimum=0.0,
            )
            for joint in joints
            if joint.value > 0
        ),
        panels=tuple(panel for joint in joints for panel in panels(joint)),
        remarks=tuple(f"{joint.contact.parameter}: {text}" for joint in joints for text in _remarks(joint)),
        others=tuple(estimate for joint in joints for estimate in _others(joint)),
        findings=tuple(finding for joint in joints for finding in _findings(joint)),
    )


def joint_damping(
    contact: FrictionContact, recordings: Sequence[Recording], parameters: Mapping[str, Number]
) -> JointDamping:
    """B of one contact."""
    joint, theta, p = contact.joint, contact.theta, momentum.parameter_vector(parameters)
    smoothed = [
        momentum.joint_recording(r, (joint,), (theta,), p, rounding=SIGN_ROUNDING) for r in recordings
    ]
    index = momentum.JOINTS.index(joint)
    records = [r for r in smoothed if _moves(r, index)]
    if not records:
        files = ", ".join(str(r.source) for r in recordings)
        raise Problem(f"{files}: {momentum.ANGLES[index]}: expected a joint in motion, got one at rest")
    start = {theta: parameters[theta].value, momentum.DRY: 0.0, momentum.OFFSET: 0.0}
    limits = data.declared_limits(recordings, momentum.PRESSURES[joint])
    problem = [r.samples for r in records], start, f"damping of the {joint}", limits
    solution = balance.solve(*problem, tested=(momentum.DRY, momentum.OFFSET))
    dry, dry_sd = solution.effect(solution.column(momentum.DRY), [solution.column(momentum.OFFSET)])
    if dry > CLEAR * dry_sd:  # else it would raise B
        solution = balance.solve(*problem, tested=[momentum.OFFSET])
        dry, dry_sd = solution.fit[momentum.DRY], solution.fit.sd(momentum.DRY)
    # the resistance is all friction plus the residual
    speed, resistance = [], []
    for r, part in zip(records, solution.parts, strict=True):
        ratio = momentum.speed_ratio(joint, r.z[:3], p)[r.samples.centres]
        by_theta = part.linear.by_theta[: len(solution.fit.values), 0]
        speed.append(-by_theta[0] / ratio)
        resistance.append((part.linear.e[0] - solution.fit.values @ by_theta) / ratio)
    return JointDamping(
        contact=contact,
        records=records,
        solution=solution,
        speed=np.concatenate(speed),
        resistance=np.concatenate(resistance),
        known_effect=momentum.known_parameter_effects(solution, parameters)[theta],
        dry=dry,
        dry_sd=dry_sd,
        at_rest=tuple(r.source.source.name for r in smoothed if not _moves(r, index)),
    )


def _moves(r: momentum.JointRecording, joint: int) -> bool:
    """Whether the speed of a joint is above its noise."""
    noise = float(np.linalg.norm(r.samples.channels[3][1]) * data.noise_sd(r.source, momentum.ANGLES[joint]))
    return bool(np.sqrt(np.mean(r.z[3 + joint] ** 2)) > max(MOVING * noise, SLOWEST))


def _findings(joint: JointDamping) -> Iterator[Finding]:
    """Tests of the residual: dry friction, a change in time, delays between sensors, zeros, the model."""
    label, solution, recordings = joint.contact.parameter, joint.solution, [r.source for r in joint.records]
    pressures = momentum.PRESSURES[joint.contact.joint]
    yield Finding(
        "dry friction",
        balance.probability(joint.dry, joint.dry_sd, sides=1),
        f"{label}: the residual has the sign of the speed, a dry friction of {joint.dry:.3g} +- "
        f"{joint.dry_sd:.2g} {joint.contact.resistance[1]}",
    )
    yield balance.drift_finding(solution, joint.contact.theta, data.courses(recordings, solution), label)
    yield balance.shift_finding(solution, pressures, label, given=(momentum.DRY, momentum.OFFSET))
    yield from balance.zero_findings(solution, label)
    yield from data.signal_findings(recordings, (*momentum.ANGLES, *pressures), label)
    yield balance.model_finding(solution, label)


def panels(joint: JointDamping) -> tuple[Panel, Panel]:
    """Resistance over speed with the line, and its residual."""
    contact, step = joint.contact, max(1, len(joint.speed) // MAX_POINTS)
    measured = Curve("a, measured", joint.speed[::step], joint.resistance[::step])
    (speed, speed_unit), (resistance, unit) = contact.speed, contact.resistance
    units = (speed_unit, 1.0), (unit, 1.0)
    return Panel(speed, resistance, (measured,), contact.joint, *units).with_line(joint.value, "B x'")


def _others(joint: JointDamping) -> Iterator[Estimate]:
    """B by the recordings alone if its interval differs, and a dry friction."""
    contact = joint.contact
    if joint.known_effect.note:
        name, note = f"{contact.parameter}, other parameters known exactly", "by the recordings alone"
        yield Estimate.normal(name, joint.value, contact.unit, joint.sd, note)
    if joint.dry > 0:  # a negative value is not a friction; a remark reports it if it is clear
        name, note = f"dry friction next to {contact.parameter}", "as a further unknown of (13)"
        yield Estimate.normal(name, joint.dry, contact.resistance[1], joint.dry_sd, note)


def _remarks(joint: JointDamping) -> Iterator[str]:
    """Sentences that follow the parameter's name and a colon."""
    unit, solution = joint.contact.unit, joint.solution
    if joint.value <= 0:
        yield (
            f"{joint.value:.3g} {unit} is not a valid damping, so this estimate is not used: the "
            "value of a known parameter must be wrong."
        )
    windows = sum(r.samples.starts.size for r in joint.records)
    possible, at_end = (sum(getattr(r, n) for r in joint.records) for n in ("possible", "at_stroke_end"))
    stops = f"; in {at_end} samples a piston was at an end of its stroke" if at_end else ""
    percent = f"{100 * (1 - windows / possible):.2g} %"
    left = f"{percent} is left out because of clipped or missing samples nearby{stops}"
    used = f"{windows} windows of {len(joint.records)} recordings are used"
    yield f"{used}, {left if windows != possible else 'nothing is left out'}."
    for name in joint.at_rest:
        yield f"in {name} the joint is at rest, so this recording is left out."
    times, noise = solution.fit.times_noise, math.sqrt(solution.normal.inverse[0, 0])
    conclusion = (
        "The model is incomplete, and the interval covers the error."
        if solution.fit.misfit
        else "Sensor noise explains the residuals, and the interval follows from the noise."
    )
    yield (
        f"the residuals are {times:.3g} times the noise of the sensors, which alone would give a standard "
        f"deviation of {noise:.3g} {unit}. {conclusion}"
    )
    yield from joint.known_effect.remarks
    if joint.dry < -CLEAR * joint.dry_sd:
        yield (
            "the resistance grows more than in proportion to the speed. The dry friction would have "
            "to be negative, which is impossible. Another cause is likely, such as a wrong known parameter."
        )
    elif joint.dry > CLEAR * joint.dry_sd:
        yield (
            f"there is a dry friction of {joint.dry:.3g} +- {joint.dry_sd:.2g} "
            f"{joint.contact.resistance[1]}. It is estimated together with B, which does not include it."
        )
