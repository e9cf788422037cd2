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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fmus.identification import balance
from fmus.identification.balance import Samples, Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.procedures.fit import Fit, Procedure, Quantity, fitted
from fmus.identification.results import Estimate, Panel, ProcedureResult
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

JOINT = "boom"
SIGNALS: Mapping[str, str] = dict.fromkeys(momentum.ANGLES, "rad") | dict.fromkeys(
    momentum.PRESSURES[JOINT], "Pa"
)
HEAD, DAMPING = "manipulator.head_mass", f"manipulator.{JOINT}_piston_damping"
CONDITION = "payload"
WINDOW = 0.6  # s: longer than by default, because the motion is slow
SIGN_ROUNDING = 0.05  # rms speeds over which the sign of the dry friction is rounded
SLOW = 0.2  # rms speeds below which a sample is left out
BOTH_WAYS = 0.2  # smallest share of the way up, and of the way down, in all of the way


@dataclass(frozen=True)
class Weighed:
    """Recordings of the boom and the fit of their masses and friction; `head` is the known mass [kg].

    If the model does not fit, zeros of the sensors would explain what it lacks: masses then are those of
    `plain`, the fit without zeros, and the zeros that the data sheets allow are in their intervals.
    """

    fit: Fit
    plain: Solution
    head: float

    @property
    def tares(self) -> list[int]:
        """The recordings of the empty head."""
        return [k for k, r in enumerate(self.fit.recordings) if data.stated(r, CONDITION) == 0.0]

    def payload(self, k: int) -> tuple[float, float]:
        """Payload [kg] of a recording and its standard deviation."""
        solution, misfit = self.fit.solution, self.fit.solution.fit.misfit
        fit = self.plain.fit if misfit else solution.fit
        contrast = np.zeros(len(fit.names))
        contrast[k] = 1.0
        for tare in self.tares:
            contrast[tare] -= 1.0 / len(self.tares)
        value = float(contrast @ fit.values) - (0.0 if self.tares else self.head)
        variance = float(contrast @ fit.covariance @ contrast)
        if misfit:
            by_residual = contrast @ self.plain.normal.inverse @ self.plain.normal.columns
            columns = solution.normal.columns[len(fit.names) :]
            limits = np.array(list(solution.limits.values()))
            variance += float(np.sum((balance.limit_sd(1.0) * limits * (columns @ by_residual)) ** 2))
        return value, math.sqrt(variance)


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """The payload of each recording that is not one of the empty head."""
    tests = data.training_recordings(recordings, "weighing", SIGNALS)
    weighed = weigh(tests, momentum.parameter_vector(parameters))
    fit, tares = weighed.fit, len(weighed.tares)
    less = f"the tare of {tares} recording{'s' * (tares > 1)}" if tares else "the known mass of the head"
    how = f"moments of the boom's cylinder, less {less}"
    names = fit.solution.fit.names
    payloads = {k: weighed.payload(k) for k in range(len(tests)) if k not in weighed.tares}
    units = ("s", 1.0), ("kN.m", 1e3)
    panels = (
        fit.over_time(
            Panel("time", "moment of the mass", (), tests[k].source.stem, *units), names[k], k, weighed.head
        )
        for k in range(len(tests))
    )
    friction = (
        Quantity("viscous friction", "N.s/m", DAMPING, how),
        Quantity("dry friction", "N", momentum.DRY, how),
    )
    return ProcedureResult(
        procedure="weighing",
        title="Payload from the pressures of the boom's cylinder",
        figure=0,
        estimates=(),
        panels=tuple(panel for both in panels for panel in both),
        remarks=tuple(_remarks(weighed, payloads)),
        others=(
            *(Estimate.normal(names[k], value, "kg", sd, how) for k, (value, sd) in payloads.items()),
            *map(fit.estimate, friction),
        ),
        findings=tuple(fit.findings({DAMPING: "friction"})),
    )


def weigh(recordings: Sequence[Recording], p: Array) -> Weighed:
    """Masses and friction of all recordings together; Problem if the boom does not move up and down."""
    names = {r.source: f"payload[{r.source.stem}]" for r in recordings}
    head = float(p[momentum.PARAMETERS.index(HEAD)])

    def prepare(recording: Recording) -> Samples:
        """With a mass of its own; the boom moves up and down."""
        s = momentum.joint_samples(
            recording, JOINT, (HEAD, DAMPING), p, window=WINDOW, slow=SLOW, rounding=SIGN_ROUNDING
        )
        speed = s.filtered(s.raw)[3 + momentum.JOINTS.index(JOINT)][s.centres]
        up, down = float(np.sum(np.maximum(speed, 0.0))), float(np.sum(np.maximum(-speed, 0.0)))
        if min(up, down) < BOTH_WAYS * (up + down) or not up + down:
            raise Problem(
                f"{recording.source}: manipulator.{JOINT}_angle: expected a slow motion up and down, in "
                f"which friction averages out, got {100 * up / (up + down or 1.0):.0f} % of the way up"
            )
        return replace(s, names=(names[recording.source], *s.names[1:]))

    start = dict.fromkeys(names.values(), head) | {DAMPING: 0.0, momentum.DRY: 0.0, momentum.OFFSET: 0.0}
    limits = {n: max(data.zero_limit(r, n) for r in recordings) for n in momentum.PRESSURES[JOINT]}
    solve = partial(fitted, "weighing", recordings, SIGNALS, prepare, start, tested=(momentum.OFFSET,))
    fit = solve(limits=limits)
    plain = solve(limits={}).solution if fit.solution.fit.misfit else fit.solution
    return Weighed(fit, plain, head)


def _remarks(weighed: Weighed, payloads: Mapping[int, tuple[float, float]]) -> Iterator[str]:
    fit, recordings = weighed.fit.solution.fit, weighed.fit.recordings
    yield from weighed.fit.remarks((), "The balance of the boom")
    if not payloads:
        yield f"All recordings are of the empty head ({CONDITION} = 0): there is no payload to weigh."
    for k, (value, sd) in payloads.items():
        stated = data.stated(recordings[k], CONDITION)
        if stated is not None:
            off = 100 * (value / stated - 1)
            yield f"{fit.names[k]}: the recording states {stated:.6g} kg; the estimate is {off:+.2g} % off."
        if not weighed.tares:
            yield (
                f"{fit.names[k]}: there is no recording of the empty head, so errors of the arm's masses are "
                f"not compensated; zeros of {', '.join(momentum.PRESSURES[JOINT])} are part of the interval, "
                f"{sd:.2g} kg."
            )
    for k in weighed.tares:
        yield (
            f"{recordings[k].source.name}: the empty head weighs "
            f"{fit.values[k] - weighed.head:+.3g} kg more than the known value."
        )


WEIGHING = Procedure("weighing", SIGNALS, identify)
