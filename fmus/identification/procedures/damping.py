"""Damping procedure (section 4(d), eq. (13), Fig. 9): viscous damping of the swing gear and the pistons.

    x' B = a        a = tau - M q'' - V - G        x' = q' of the swing, J q' of a piston

tau is that of measured pressures, less the known viscous friction of the joints; M, V, G are those of the
manipulator. B is the unknown of the momentum balance (`momentum_balance`), without accelerations.

Validity: viscous friction, all other parameters known. A dry friction is a further unknown if it is clear. B
absorbs all other effects, as the paper notes; the remarks quantify them.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np

from fmus.identification import balance
from fmus.identification.balance import Samples
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.procedures.procedure import (
    Computed,
    Fit,
    Parameters,
    Procedure,
    Quantity,
    Recordings,
    solve,
)
from fmus.identification.recordings.reading import require
from fmus.identification.results import Estimate, Finding, Panel, ProcedureResult, joined
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

SIGNALS: Mapping[str, str] = momentum.SIGNALS  # of the pressures only those of the joint are needed
SIGN_ROUNDING = 0.003  # rms speeds over which the sign of a dry friction is rounded; 0.03 biases B by 4 %
MOVING = 3.0  # standard deviations of its noise above which a root mean square speed is a motion
SLOWEST = 1e-6  # rad/s: a smaller speed is a rounding error


@dataclass(frozen=True)
class FrictionContact:
    """Location of a viscous friction: parameter with unit, axes of its resistance over the speed."""

    parameter: str
    unit: str
    panel: Panel

    @property
    def theta(self) -> str:
        """Name of the parameter with its part."""
        return f"manipulator.{self.parameter}"

    @property
    def force_unit(self) -> str:
        """That of the resistance."""
        return self.panel.y_unit[0]


def _piston(joint: str) -> FrictionContact:
    axes = Panel(f"speed of the {joint} piston", "force of its friction", (), joint, ("m/s", 1.0), ("N", 1.0))
    return FrictionContact(f"{joint}_piston_damping", "N.s/m", axes)


GEAR = Panel("swing speed", "torque of the gear's friction", (), "swing", ("rad/s", 1.0), ("N.m", 1.0))
SWING = FrictionContact("swing_damping", "N.m.s/rad", GEAR)
BY_JOINT = {"swing": SWING, "boom": _piston("boom"), "stick": _piston("stick")}


def identify(recordings: Recordings, parameters: Parameters) -> ProcedureResult:
    """B of each joint that has recordings."""
    tests = data.training_recordings(recordings, "damping", dict.fromkeys(momentum.ANGLES, "rad"))
    joints = [data.condition(r, "joint", BY_JOINT) for r in tests]
    for r, joint in zip(tests, joints, strict=True):
        require(r, dict.fromkeys(momentum.PRESSURES[joint], "Pa"))
    results = []
    for joint in (j for j in BY_JOINT if j in joints):
        own = [r for r, j in zip(tests, joints, strict=True) if j == joint]
        declared, moving = of_joint(joint, own, parameters)
        found = solve(declared, moving, parameters)
        results.append(replace(found, remarks=tuple(f"{declared.label}: {text}" for text in found.remarks)))
    return joined(results)


def of_joint(joint: str, tests: Recordings, parameters: Parameters) -> tuple[Procedure, list[Recording]]:
    """The procedure of one joint, and the recordings in which it moves."""
    contact, index, p = BY_JOINT[joint], momentum.JOINTS.index(joint), momentum.HARVESTER.vector(parameters)

    def samples(recording: Recording) -> Samples:
        return momentum.joint_samples(recording, joint, (contact.theta,), p, rounding=SIGN_ROUNDING)

    moving = [r for r in tests if moves(r, samples(r), index)]
    if not moving:
        files = ", ".join(str(r.source) for r in tests)
        raise Problem(f"{files}: {momentum.ANGLES[index]}: expected a joint in motion, got one at rest")
    at_rest = [r.source.name for r in tests if not any(r is m for m in moving)]
    declared = Procedure(
        name="damping",
        label=contact.parameter,
        title="Viscous damping of the joints: resistance over speed",
        figure=9,
        signals=dict.fromkeys(momentum.needed_signals(joint), ""),
        law="Eq. (13)",
        known=lambda *_: SimpleNamespace(joint=joint, contact=contact, at_rest=at_rest, p=p),
        samples=lambda some, _: [data.with_course(r, samples(r)) for r in some],
        start=lambda _: {
            contact.theta: parameters[contact.theta].value,
            momentum.DRY: 0.0,
            momentum.OFFSET: 0.0,
        },
        limits=lambda some: data.declared_limits(some, momentum.PRESSURES[joint]),
        loggers=[momentum.PRESSURES[joint]],
        tested=(momentum.DRY, momentum.OFFSET),
        refined=partial(_refined, parameters),
        estimates=_estimates,
        others=_others,
        panels=_panels,
        remarks=_remarks,
        findings=_findings,
        drift={contact.theta: "B"},
    )
    return declared, moving


def moves(recording: Recording, s: Samples, joint: int) -> bool:
    """Whether the speed of a joint is above its noise."""
    noise = float(np.linalg.norm(s.channels[3][1]) * data.noise_sd(recording, momentum.ANGLES[joint]))
    rms = np.sqrt(np.mean(s.filtered(s.raw)[3 + joint] ** 2))
    return bool(rms > max(MOVING * noise, SLOWEST))


def _refined(parameters: Parameters, fit: Fit, again: Callable[[Procedure], Fit]) -> Fit:
    """With a dry friction as an unknown if it is clear, else it would raise B; and what known errors do."""
    dry, sd = dry_friction(fit)
    if dry > balance.SIGNIFICANT * sd:
        fit = again(replace(fit.procedure, tested=[momentum.OFFSET]))
    effect = momentum.known_parameter_effect(fit.solution, parameters, fit.known.contact.theta)
    return replace(fit, known=SimpleNamespace(**vars(fit.known), effect=effect))


def dry_friction(fit: Fit) -> tuple[float, float]:
    """A dry friction, tested or estimated with B, and its standard deviation."""
    if momentum.DRY in fit.solution.fit.names:
        return fit[momentum.DRY], fit.sd(momentum.DRY)
    column = fit.solution.column
    return fit.solution.effect(column(momentum.DRY), [column(momentum.OFFSET)])


def _estimates(fit: Fit) -> Iterator[Estimate]:
    contact, effect = fit.known.contact, fit.known.effect
    note = f"eq. (13) by impulses and momenta{effect.note}"
    if (b := fit[contact.theta]) > 0:
        yield Estimate.normal(contact.parameter, b, contact.unit, effect.total, note, minimum=0.0)


def _others(fit: Fit) -> Iterator[Estimate]:
    contact, (dry, sd) = fit.known.contact, dry_friction(fit)
    if fit.known.effect.note:
        alone = f"{contact.parameter}, other parameters known exactly"
        yield fit.estimate(Quantity(alone, contact.unit, contact.theta, "by the recordings alone"))
    if dry > 0:  # a negative value is not a friction; a remark reports it if it is clear
        name, note = f"dry friction next to {contact.parameter}", "as a further unknown of (13)"
        yield Estimate.normal(name, dry, contact.force_unit, sd, note)


def _panels(fit: Fit) -> Iterator[Panel]:
    contact, joint, p = fit.known.contact, fit.known.joint, fit.known.p
    every = ((s, s.filtered(s.raw)) for s in fit.solution.samples)
    ratio = np.concatenate([momentum.speed_ratio(joint, z, p)[s.centres] for s, z in every])
    yield from fit.line(contact.panel, contact.theta, per=ratio)


def _findings(fit: Fit) -> Iterator[Finding]:
    dry, sd = dry_friction(fit)
    told = f"a dry friction of {dry:.3g} +- {sd:.2g} {fit.known.contact.force_unit}"
    sentence = f"{fit.label}: the residual has the sign of the speed, {told}"
    yield Finding("dry friction", balance.probability(dry, sd, sides=1), sentence)


def _remarks(fit: Fit) -> Iterator[str]:
    """Sentences that follow the parameter's name and a colon."""
    contact, (dry, sd) = fit.known.contact, dry_friction(fit)
    if (b := fit[contact.theta]) <= 0:
        yield (
            f"{b:.3g} {contact.unit} is not a valid damping, so this estimate is not used: "
            "the value of a known parameter must be wrong."
        )
    for name in fit.known.at_rest:
        yield f"in {name} the joint is at rest, so this recording is left out."
    if dry < -balance.SIGNIFICANT * sd:
        yield (
            "the resistance grows more than in proportion to the speed. The dry friction would have "
            "to be negative, which is impossible. Another cause is likely, such as a wrong known parameter."
        )
    elif dry > balance.SIGNIFICANT * sd:
        yield (
            f"there is a dry friction of {dry:.3g} +- {sd:.2g} {contact.force_unit}. It is estimated "
            "together with B, which does not include it."
        )
    yield from fit.known.effect.remarks


DAMPING = Computed("damping", SIGNALS, identify)
