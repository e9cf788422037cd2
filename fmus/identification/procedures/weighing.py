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
from fmus.identification.results import Curve, Estimate, Panel, ProcedureResult
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

    records: Sequence[momentum.JointRecording]
    solution: Solution
    plain: Solution
    head: float

    @property
    def tares(self) -> list[int]:
        """The recordings of the empty head."""
        return [k for k, r in enumerate(self.records) if data.stated(r.source, CONDITION) == 0.0]

    def payload(self, k: int) -> tuple[float, float]:
        """Payload [kg] of a recording and its standard deviation."""
        fit = self.plain.fit if self.solution.fit.misfit else self.solution.fit
        contrast = np.zeros(len(fit.names))
        contrast[k] = 1.0
        for tare in self.tares:
            contrast[tare] -= 1.0 / len(self.tares)
        value = float(contrast @ fit.values) - (0.0 if self.tares else self.head)
        variance = float(contrast @ fit.covariance @ contrast)
        if self.solution.fit.misfit:
            by_residual = contrast @ self.plain.normal.inverse @ self.plain.normal.columns
            columns = self.solution.normal.columns[len(fit.names) :]
            limits = np.array(list(self.solution.limits.values()))
            variance += float(np.sum((balance.zero_sd(1.0) * limits * (columns @ by_residual)) ** 2))
        return value, math.sqrt(variance)


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """The payload of each recording that is not one of the empty head."""
    tests = data.training_recordings(recordings, "weighing", SIGNALS)
    weighed = weigh(tests, momentum.parameter_vector(parameters))
    solution, fit, tares = weighed.solution, weighed.solution.fit, len(weighed.tares)
    less = f"the tare of {tares} recording{'s' * (tares > 1)}" if tares else "the known mass of the head"
    how = f"moments of the boom's cylinder, less {less}"
    payloads = {k: weighed.payload(k) for k in range(len(tests)) if k not in weighed.tares}
    return ProcedureResult(
        procedure="weighing",
        title="Payload from the pressures of the boom's cylinder",
        figure=0,
        estimates=(),
        panels=tuple(panel for k in range(len(tests)) for panel in _panels(weighed, k)),
        remarks=tuple(_remarks(weighed, payloads)),
        others=(
            *(Estimate.normal(fit.names[k], value, "kg", sd, how) for k, (value, sd) in payloads.items()),
            fit.estimate("viscous friction, further unknown", "N.s/m", how, DAMPING),
            fit.estimate("dry friction, further unknown", "N", how, momentum.DRY),
        ),
        findings=(
            balance.drift_finding(solution, DAMPING, data.courses(tests, solution), "weighing: friction"),
            *balance.zero_findings(solution, "weighing"),
            *data.signal_findings(tests, SIGNALS, "weighing"),
            balance.model_finding(solution, "weighing"),
        ),
    )


def weigh(recordings: Sequence[Recording], p: Array) -> Weighed:
    """Masses and friction of all recordings together; Problem if the boom does not move up and down."""
    records, samples = list[momentum.JointRecording](), list[Samples]()
    names = [f"payload[{r.source.stem}]" for r in recordings]
    for name, r in zip(names, recordings, strict=True):
        record = momentum.joint_recording(
            r, (JOINT,), (HEAD, DAMPING), p, window=WINDOW, slow=SLOW, rounding=SIGN_ROUNDING
        )
        speed = record.z[3 + momentum.JOINTS.index(JOINT)][record.samples.centres]
        up, down = float(np.sum(np.maximum(speed, 0.0))), float(np.sum(np.maximum(-speed, 0.0)))
        if min(up, down) < BOTH_WAYS * (up + down) or not up + down:
            raise Problem(
                f"{r.source}: manipulator.{JOINT}_angle: expected a slow motion up and down, in "
                f"which friction averages out, got {100 * up / (up + down or 1.0):.0f} % of the way up"
            )
        records.append(record)
        samples.append(replace(record.samples, names=(name, *record.samples.names[1:])))
    head = float(p[momentum.PARAMETERS.index(HEAD)])
    start = dict.fromkeys(names, head) | {DAMPING: 0.0, momentum.DRY: 0.0, momentum.OFFSET: 0.0}
    limits = {n: max(data.zero_limit(r, n) for r in recordings) for n in momentum.PRESSURES[JOINT]}
    solve = partial(balance.solve, samples, start, "weighing", tested=(momentum.OFFSET,))
    solution = solve(limits)
    return Weighed(records, solution, solve() if solution.fit.misfit else solution, head)


def _remarks(weighed: Weighed, payloads: Mapping[int, tuple[float, float]]) -> Iterator[str]:
    fit, limits = weighed.solution.fit, weighed.solution.limits
    if not payloads:
        yield f"All recordings are of the empty head ({CONDITION} = 0): there is no payload to weigh."
    for k, (value, sd) in payloads.items():
        stated = data.stated(weighed.records[k].source, CONDITION)
        if stated is not None:
            off = 100 * (value / stated - 1)
            yield f"{fit.names[k]}: the recording states {stated:.6g} kg; the estimate is {off:+.2g} % off."
        if not weighed.tares:
            yield (
                f"{fit.names[k]}: there is no recording of the empty head, so errors of the arm's masses are "
                f"not compensated; zeros of {', '.join(limits)} are part of the interval, {sd:.2g} kg."
            )
    for k in weighed.tares:
        yield (
            f"{weighed.records[k].source.source.name}: the empty head weighs "
            f"{fit.values[k] - weighed.head:+.3g} kg more than the known value."
        )


def _panels(weighed: Weighed, k: int) -> tuple[Panel, Panel]:
    """Moment of the mass above the empty head over time, and the residual, of one recording."""
    record, linear = weighed.records[k], weighed.solution.parts[k].linear
    by_mass = -linear.by_theta[0, 0] * (weighed.solution.fit.values[k] - weighed.head)
    measured = Curve("measured, filtered, without friction", by_mass, by_mass + linear.e[0])
    fit, title = Curve("by the mass", by_mass, by_mass, "fit"), record.source.source.stem
    return momentum.torque_panels(
        ("time", "moment of the mass"), title, record, measured, fit, "measured - fit"
    )
