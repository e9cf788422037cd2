"""Damping procedure (section 4(d), eq. (13), Fig. 9): viscous damping of the swing gear and the pistons.

    x' B = a        a = tau - M q'' - V - G        x' = q' of the swing, J q' of a piston

tau is that of measured pressures; M, V, G are those of the manipulator, with the known viscous friction of
the joints. B is the unknown of the momentum balance (`momentum_balance`), without accelerations.

Validity: viscous friction, all other parameters known. A dry friction is a further unknown if it is clear. B
absorbs all other effects, as the paper notes; the remarks quantify them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fmus.identification import balance
from fmus.identification.balance import Samples
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.procedures.fit import Fit, Procedure, Quantity, fitted
from fmus.identification.recordings.reading import require
from fmus.identification.results import Estimate, Finding, Panel, ProcedureResult
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

SIGNALS: Mapping[str, str] = momentum.SIGNALS  # of the pressures only those of the joint are needed
SIGN_ROUNDING = 0.003  # rms speeds over which the sign of a dry friction is rounded; 0.03 biases B by 4 %
MOVING = 3.0  # standard deviations of its noise above which a root mean square speed is a motion
SLOWEST = 1e-6  # rad/s: a smaller speed is a rounding error
CLEAR = 4.0  # standard deviations above which a dry friction is reported, and estimated together with B


@dataclass(frozen=True)
class FrictionContact:
    """Location of a viscous friction: its parameter, and names and units of speed and resistance."""

    parameter: str
    unit: str
    speed: str
    speed_unit: str
    resistance: str
    force_unit: str

    @property
    def theta(self) -> str:
        """Name of the parameter with its part."""
        return f"manipulator.{self.parameter}"


def _piston(joint: str) -> FrictionContact:
    speed = f"speed of the {joint} piston"
    return FrictionContact(f"{joint}_piston_damping", "N.s/m", speed, "m/s", "force of its friction", "N")


SWING = FrictionContact(
    "swing_damping", "N.m.s/rad", "swing speed", "rad/s", "torque of the gear's friction", "N.m"
)
BY_JOINT = {"swing": SWING, "boom": _piston("boom"), "stick": _piston("stick")}


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """B of each joint that has recordings."""
    by_joint: dict[str, list[Recording]] = {joint: [] for joint in BY_JOINT}
    for recording in data.training_recordings(recordings, "damping", dict.fromkeys(momentum.ANGLES, "rad")):
        joint = data.condition(recording, "joint", BY_JOINT)
        require(recording, dict.fromkeys(momentum.PRESSURES[joint], "Pa"))
        by_joint[joint].append(recording)
    estimates, others, panels = list[Estimate](), list[Estimate](), list[Panel]()
    remarks, findings = list[str](), list[Finding]()
    for joint, own in ((j, own) for j, own in by_joint.items() if own):
        contact, fit, at_rest = BY_JOINT[joint], *joint_fit(joint, own, parameters)
        b, effect = (
            fit[contact.theta],
            momentum.known_parameter_effects(fit.solution, parameters)[contact.theta],
        )
        dry, dry_sd, note = *dry_friction(fit), f"eq. (13) by impulses and momenta{effect.note}"
        if b > 0:
            estimates.append(
                Estimate.normal(contact.parameter, b, contact.unit, effect.total, note, minimum=0.0)
            )
        if effect.note:
            alone, note = f"{contact.parameter}, other parameters known exactly", "by the recordings alone"
            others.append(fit.estimate(Quantity(alone, contact.unit, contact.theta, note)))
        if dry > 0:  # a negative value is not a friction; a remark reports it if it is clear
            name, note = f"dry friction next to {contact.parameter}", "as a further unknown of (13)"
            others.append(Estimate.normal(name, dry, contact.force_unit, dry_sd, note))
        p, units = (
            momentum.parameter_vector(parameters),
            ((contact.speed_unit, 1.0), (contact.force_unit, 1.0)),
        )
        ratios = [momentum.speed_ratio(joint, z, p)[s.centres] for s, z in filtered(fit)]
        panel = Panel(contact.speed, contact.resistance, (), joint, *units)
        panels += fit.line(panel, contact.theta, per=np.concatenate(ratios))
        told = (*_remarks(contact, fit, at_rest), *effect.remarks)
        remarks += [f"{contact.parameter}: {text}" for text in told]
        findings += _findings(contact, fit)
    return ProcedureResult(
        procedure="damping",
        title="Viscous damping of the joints: resistance over speed",
        figure=9,
        estimates=tuple(estimates),
        panels=tuple(panels),
        remarks=tuple(remarks),
        others=tuple(others),
        findings=tuple(findings),
    )


def filtered(fit: Fit) -> Iterator[tuple[Samples, np.ndarray]]:
    """The samples of each recording, and z: angles, speeds and pressures."""
    return ((s, s.filtered(s.raw)) for s in fit.solution.samples)


def joint_fit(
    joint: str, recordings: Sequence[Recording], parameters: Mapping[str, Number]
) -> tuple[Fit, list[str]]:
    """The fit of one joint, and names of the files in which it does not move, which are left out."""
    theta, index = BY_JOINT[joint].theta, momentum.JOINTS.index(joint)
    p = momentum.parameter_vector(parameters)
    prepare = partial(momentum.joint_samples, joint=joint, theta=(theta,), p=p, rounding=SIGN_ROUNDING)
    moving = [r for r in recordings if moves(r, prepare(r), index)]
    if not moving:
        files = ", ".join(str(r.source) for r in recordings)
        raise Problem(f"{files}: {momentum.ANGLES[index]}: expected a joint in motion, got one at rest")
    solve = partial(
        fitted,
        BY_JOINT[joint].parameter,
        moving,
        momentum.needed_signals(joint),
        prepare,
        {theta: parameters[theta].value, momentum.DRY: 0.0, momentum.OFFSET: 0.0},
        data.declared_limits(recordings, momentum.PRESSURES[joint]),
        loggers=[momentum.PRESSURES[joint]],
    )
    fit = solve(tested=(momentum.DRY, momentum.OFFSET))
    dry, sd = dry_friction(fit)
    if dry > CLEAR * sd:  # else it would raise B
        fit = solve(tested=[momentum.OFFSET])
    return fit, [r.source.name for r in recordings if not any(r is m for m in moving)]


def moves(recording: Recording, s: Samples, joint: int) -> bool:
    """Whether the speed of a joint is above its noise."""
    noise = float(np.linalg.norm(s.channels[3][1]) * data.noise_sd(recording, momentum.ANGLES[joint]))
    rms = np.sqrt(np.mean(s.filtered(s.raw)[3 + joint] ** 2))
    return bool(rms > max(MOVING * noise, SLOWEST))


def dry_friction(fit: Fit) -> tuple[float, float]:
    """A dry friction, tested or estimated with B, and its standard deviation."""
    if momentum.DRY in fit.solution.fit.names:
        return fit[momentum.DRY], fit.sd(momentum.DRY)
    column = fit.solution.column
    return fit.solution.effect(column(momentum.DRY), [column(momentum.OFFSET)])


def _findings(contact: FrictionContact, fit: Fit) -> Iterator[Finding]:
    dry, sd = dry_friction(fit)
    yield Finding(
        "dry friction",
        balance.probability(dry, sd, sides=1),
        f"{fit.label}: the residual has the sign of the speed, a dry friction of {dry:.3g} +- "
        f"{sd:.2g} {contact.force_unit}",
    )
    yield from fit.findings({contact.theta: "B"}, free=(momentum.DRY, momentum.OFFSET))


def _remarks(contact: FrictionContact, fit: Fit, at_rest: Sequence[str]) -> Iterator[str]:
    """Sentences that follow the parameter's name and a colon."""
    if fit[contact.theta] <= 0:
        yield (
            f"{fit[contact.theta]:.3g} {contact.unit} is not a valid damping, so this estimate is not used: "
            "the value of a known parameter must be wrong."
        )
    yield from fit.remarks((), "Eq. (13)")
    for name in at_rest:
        yield f"in {name} the joint is at rest, so this recording is left out."
    dry, sd = dry_friction(fit)
    if dry < -CLEAR * sd:
        yield (
            "the resistance grows more than in proportion to the speed. The dry friction would have "
            "to be negative, which is impossible. Another cause is likely, such as a wrong known parameter."
        )
    elif dry > CLEAR * sd:
        yield (
            f"there is a dry friction of {dry:.3g} +- {sd:.2g} {contact.force_unit}. It is estimated "
            "together with B, which does not include it."
        )


DAMPING = Procedure("damping", SIGNALS, identify)
