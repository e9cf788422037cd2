"""Weighing procedure: the payload of the head from pressures of the boom's cylinder and joint angles.

The boom moves slowly up and down, swing and stick at rest. Unknowns of its momentum balance
(`momentum_balance`) are the mass m at the tip in each recording, empty head and payload together, and a
viscous and a dry friction, which are the same in all recordings: friction acts against the motion up and the
motion down, and thereby averages out. Where the boom is slower than `SLOW` of its rms speed, stiction holds
unknown forces, so these samples are left out. The zeros of the pressure sensors are columns, the same in all
recordings.

payload = m - m_tare    with a recording of the empty head, whose condition `payload` is 0: errors of the
                        arm's masses and geometry, and of the sensors' zeros, then cancel nearly
payload = m - m_0       without one, with the known mass m_0: the zeros remain in the interval, the other
                        parameters are taken as exact

Validity: slow motion that goes up and down about equally; a payload that does not change; friction
independent of load. The payload is a point mass at or below the tip, at the tip's distance from the boom.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fmus.identification import balance
from fmus.identification.balance import Samples, Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.procedures.procedure import Fit, Parameters, Parts, Procedure, Quantity, Recordings
from fmus.identification.results import Estimate, Panel
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

JOINT = "boom"
SIGNALS: Mapping[str, str] = dict.fromkeys(momentum.ANGLES, "rad") | dict.fromkeys(
    momentum.PRESSURES[JOINT], "Pa"
)
HEAD, DAMPING = "manipulator.head_mass", f"manipulator.{JOINT}_piston_damping"
WINDOW = 0.6  # s: longer than by default, because the motion is slow
SIGN_ROUNDING = 0.05  # rms speeds over which the sign of the dry friction is rounded
SLOW = 0.2  # rms speeds below which a sample is left out
BOTH_WAYS = 0.2  # smallest share of the way up, and of the way down, in all of the way


@dataclass(frozen=True)
class Weighed:
    """What is known: parameters of the machine, the unknown mass of each recording, the empty ones of these.

    plain   the fit without zeros if the model does not fit: zeros would explain what it lacks. Masses then
            are those of `plain`, and the zeros that the data sheets allow are in their intervals
    """

    p: Array
    masses: tuple[str, ...]
    stated: tuple[float | None, ...]
    plain: Solution | None = None

    @classmethod
    def of(cls, tests: Recordings, parameters: Parameters) -> "Weighed":
        masses = tuple(f"payload[{r.source.stem}]" for r in tests)
        return cls(
            momentum.HARVESTER.vector(parameters), masses, tuple(data.stated(r, "payload") for r in tests)
        )

    @property
    def head(self) -> float:
        """Known mass of the empty head [kg]."""
        return float(self.p[momentum.PARAMETERS.index(HEAD)])

    @property
    def tares(self) -> list[int]:
        """The recordings of the empty head."""
        return [k for k, x in enumerate(self.stated) if x == 0.0]

    @property
    def how(self) -> str:
        """For the note of an estimate."""
        tares = len(self.tares)
        less = f"the tare of {tares} recording{'s' * (tares > 1)}" if tares else "the known mass of the head"
        return f"moments of the boom's cylinder, less {less}"


def _samples(tests: Recordings, known: Weighed) -> Parts:
    return [data.with_course(r, _moving(r, mass, known)) for r, mass in zip(tests, known.masses, strict=True)]


def _moving(recording: Recording, mass: str, known: Weighed) -> Samples:
    """With a mass of its own; the boom moves up and down."""
    s = momentum.joint_samples(
        recording, JOINT, (HEAD, DAMPING), known.p, window=WINDOW, slow=SLOW, rounding=SIGN_ROUNDING
    )
    speed = s.filtered(s.raw)[3 + momentum.JOINTS.index(JOINT)][s.centres]
    up, down = float(np.sum(np.maximum(speed, 0.0))), float(np.sum(np.maximum(-speed, 0.0)))
    if min(up, down) < BOTH_WAYS * (up + down) or not up + down:
        raise Problem(
            f"{recording.source}: manipulator.{JOINT}_angle: expected a slow motion up and down, in "
            f"which friction averages out, got {100 * up / (up + down or 1.0):.0f} % of the way up"
        )
    return replace(s, names=(mass, *s.names[1:]))


def _refined(fit: Fit, again: Callable[[Procedure], Fit]) -> Fit:
    """With the solution without zeros of sensors beside it, which tells what a misfit may be."""
    if not fit.solution.fit.misfit:
        return fit
    plain = again(replace(fit.procedure, limits=lambda _: {})).solution
    return replace(fit, known=replace(fit.known, plain=plain))


def payloads(fit: Fit) -> dict[int, tuple[float, float]]:
    """Payload [kg] of each recording that is not of the empty head, and its standard deviation."""
    solution, known = fit.solution, fit.known
    used, found = (known.plain or solution).fit, {}
    for k in range(len(known.masses)):
        contrast = np.zeros(len(used.names))
        contrast[k] = 1.0
        for tare in known.tares:
            contrast[tare] -= 1.0 / len(known.tares)
        value = float(contrast @ used.values) - (0.0 if known.tares else known.head)
        variance = float(contrast @ used.covariance @ contrast)
        if known.plain:
            by_residual = contrast @ known.plain.normal.inverse @ known.plain.normal.columns
            columns, limits = solution.normal.columns[len(used.names) :], [*solution.limits.values()]
            by_zero = balance.limit_sd(1.0) * np.array(limits) * (columns @ by_residual)
            variance += float(np.sum(by_zero**2))
        if k not in known.tares:
            found[k] = value, math.sqrt(variance)
    return found


def _others(fit: Fit) -> Iterator[Estimate]:
    known = fit.known
    for k, (value, sd) in payloads(fit).items():
        yield Estimate.normal(known.masses[k], value, "kg", sd, known.how)
    yield fit.estimate(Quantity("viscous friction", "N.s/m", DAMPING, known.how))
    yield fit.estimate(Quantity("dry friction", "N", momentum.DRY, known.how))


def _panels(fit: Fit) -> Iterator[Panel]:
    for k, (r, mass) in enumerate(zip(fit.recordings, fit.known.masses, strict=True)):
        panel = Panel("time", "moment of the mass", (), r.source.stem, ("s", 1.0), ("kN.m", 1e3))
        yield from fit.over_time(panel, mass, k, fit.known.head)


def _remarks(fit: Fit) -> Iterator[str]:
    known, found = fit.known, payloads(fit)
    if not found:
        yield "All recordings are of the empty head (payload = 0): there is no payload to weigh."
    for k, (value, sd) in found.items():
        name = known.masses[k]
        if stated := known.stated[k]:
            off = 100 * (value / stated - 1)
            yield f"{name}: the recording states {stated:.6g} kg; the estimate is {off:+.2g} % off."
        if not known.tares:
            yield (
                f"{name}: there is no recording of the empty head, so errors of the arm's masses are "
                f"not compensated; zeros of {', '.join(momentum.PRESSURES[JOINT])} are part of the interval, "
                f"{sd:.2g} kg."
            )
    for k in known.tares:
        more, file = fit[known.masses[k]] - known.head, fit.recordings[k].source.name
        yield f"{file}: the empty head weighs {more:+.3g} kg more than the known value."


WEIGHING = Procedure(
    name="weighing",
    title="Payload from the pressures of the boom's cylinder",
    figure=0,
    signals=SIGNALS,
    law="The balance of the boom",
    known=Weighed.of,
    samples=_samples,
    start=lambda known: (
        dict.fromkeys(known.masses, known.head) | {DAMPING: 0.0, momentum.DRY: 0.0, momentum.OFFSET: 0.0}
    ),
    limits=lambda tests: {n: max(data.zero_limit(r, n) for r in tests) for n in momentum.PRESSURES[JOINT]},
    tested=[momentum.OFFSET],
    refined=_refined,
    others=_others,
    panels=_panels,
    remarks=_remarks,
    drift={DAMPING: "friction"},
)
