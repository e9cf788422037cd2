"""Texts of the identification report: rounded values with intervals, warnings, captions."""

import math
from collections.abc import Iterable

import numpy as np

from fmus.identification.refinement.refine import RefinementResult
from fmus.identification.refinement.statistics import nrmse
from fmus.identification.report.prediction import WINDOW
from fmus.identification.results import Estimate
from orchestrator.base import text
from orchestrator.base.text import DASH, display_unit, sentences, typeset
from orchestrator.data.recording import Recording

FAR = 3.0  # residuals over noise from which on eight ninths of chi-square are errors of the model


def number(value: float | None, digits: int = 3, unit: str = "1") -> str:
    """A number with significant digits in the display unit of `unit`, typeset; a dash for None."""
    shown = None if value is None else display_unit(unit).factor * value
    return typeset(text.number(shown, digits, zeros=True))


def value(estimate: Estimate) -> str:
    """The value in its display unit."""
    return number(estimate.value, estimate.digits, estimate.unit)


def value_and_interval(estimate: Estimate) -> str:
    """The value with its unit and, in brackets, the 95 % interval."""
    return f"{value(estimate)} {display_unit(estimate.unit).name} ({interval(estimate)})".replace("  ", " ")


def interval(estimate: Estimate) -> str:
    """The 95 % interval in the display unit."""
    return " to ".join(_aligned(end, estimate) for end in (estimate.low, estimate.high))


def _aligned(end: float, estimate: Estimate) -> str:
    """An end of the interval, with as many decimals as the value."""
    if math.isinf(end):
        return "open"
    if not math.isfinite(end) or not end or not estimate.value:
        return number(end, unit=estimate.unit)
    factor = display_unit(estimate.unit).factor
    size, of_end = (math.floor(math.log10(abs(factor * x))) for x in (estimate.value, end))
    return number(end, max(1, estimate.digits - size + of_end), estimate.unit)


def percentage(value: float | None, digits: int = 2) -> str:
    """A ratio as percentage; rounding errors are zero."""
    if value is not None and abs(value) < 1e-9:
        return "0 %"
    return typeset(text.percentage(value, digits, zeros=True))


def change(value: float, before: float | None) -> str:
    """Relative change of a value as percentage."""
    if before is None or before == 0:
        return DASH
    percent = 100 * (value / before - 1)
    return f"{'+' if percent > 0 else ''}{number(percent, 2)} %"


def probability(p: float | None) -> str:
    """A probability, with a lower limit."""
    return "< 0.001" if p is not None and p < 1e-3 else number(p, 2)


NAMED = 3  # signals named in a warning
POOR = 0.2  # training NRMSE above which signs, units or the assignment of levers must be wrong
CHECK = (
    "Check before you use the numbers: which command moves which joint, the sign and time of each command, "
    "angle and flow, the unit of each signal, and the pose from which each recording begins."
)


def warnings(refined: RefinementResult) -> list[str]:
    """Sentences on doubtful results, the last one with advice; empty if there is no doubt."""
    sentences = []
    if not refined.converged:
        sentences.append(f"The search did not converge: {refined.reason}.")
    if refined.at_bound:
        sentences.append(f"At a bound, so not identified: {', '.join(refined.at_bound)}.")
    residual = refined.history[-1].residual if refined.history else 0.0
    if residual > FAR:
        ratios = {n: test.rms for n, test in refined.whiteness.items() if test.rms > FAR}
        largest = sorted(ratios, key=lambda name: -ratios[name])[:NAMED]
        far = ", ".join(f"{name} {ratios[name]:.3g} times" for name in largest)
        sentences.append(
            f"The joint refinement leaves residuals {residual:.3g} times as large as the noise of the "
            f"sensors{f' ({far})' if far else ''}: the data contain an effect that the model lacks, "
            "and the estimates compensate for this effect. The report shows which effects are likely."
        )
    errors = dict(zip(refined.problem.signals, nrmse(refined.training), strict=True))
    if poor := sorted((n for n, error in errors.items() if error > POOR), key=lambda n: -errors[n]):
        sentences.append(
            "The model does not even reproduce the recordings that were used for fitting. NRMSE above "
            f"{percent(POOR)} of the range: {', '.join(f'{n} {percent(errors[n])}' for n in poor)}."
        )
    return [*sentences, CHECK] if sentences else []


def percent(ratio: float) -> str:
    """A ratio in whole percent; infinite for a simulation that failed."""
    return f"{100 * ratio:.0f} %" if np.isfinite(ratio) else "(could not be simulated)"


SIMULATED = "simulated data (virtual test rig), not FERIC data"
KINDS = {"simulation": SIMULATED, "published": "published data", "measurement": "measured data"}


def origin(kinds: Iterable[str]) -> str:
    """Origin of the data: a description of each kind of recording."""
    return "; ".join(dict.fromkeys(KINDS.get(kind, kind) for kind in kinds))


def footer(number: int, kinds: Iterable[str]) -> str:
    """The origin of a figure's data, and the figure of the paper that it corresponds to, 0 for none."""
    parts = [origin(kinds), f"cf. Fig. {number} of the paper" if number else ""]
    return " · ".join(part for part in parts if part)


def joint_caption(recording: Recording, joint: str) -> str:
    """What the figure of a joint shows."""
    use = "not used for fitting" if recording.use == "test" else "used for fitting"
    return sentences(
        f"Measured and predicted signals of the {joint} over {recording.title}, {use}",
        f"Speeds: both angles differentiated by one filter, {1000 * WINDOW:.0f} ms wide",
        "Flows in the dead zone of the meter are left out",
    )
