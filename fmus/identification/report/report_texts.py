"""Texts of the identification report: values with the digits of their interval, warnings, captions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from fmus.identification.estimate import Estimate
from fmus.identification.procedure_result import ProcedureResult
from fmus.identification.refinement.refine import RefinementResult
from orchestrator.base import text
from orchestrator.base.text import DASH, display_unit, sentences, typeset

WIDE = 0.5  # of a value: an interval with a larger half is shown as a factor
FACTOR = "\N{MULTIPLICATION SIGN}÷"


def unit(name: str) -> str:
    """The display unit as print has it; nothing for a pure number."""
    return display_unit(name).name


def in_unit(value: float, name: str) -> float:
    """A value in SI in the display unit."""
    return display_unit(name).factor * value


def number(value: float | None, digits: int = 3) -> str:
    """A number with significant digits as print has it; a dash where there is none."""
    return typeset(text.number(value, digits, zeros=True))


def digits(estimate: Estimate) -> int:
    """Significant digits that show the interval with two of its own."""
    half, size = (estimate.high - estimate.low) / 2, abs(estimate.value)
    if not (half > 0 and size > 0 and math.isfinite(half)):
        return 4
    return min(7, max(2, math.floor(math.log10(size)) - math.floor(math.log10(half)) + 2))


def value(estimate: Estimate) -> str:
    """The value in its display unit."""
    return number(in_unit(estimate.value, estimate.unit), digits(estimate))


def interval(estimate: Estimate) -> str:
    """The 95 % interval in the display unit."""
    ends = (in_unit(end, estimate.unit) for end in (estimate.low, estimate.high))
    return " to ".join(_aligned(end, estimate) for end in ends)


def _aligned(end: float, estimate: Estimate) -> str:
    """An end of the interval with as many decimals as the value."""
    if math.isinf(end):
        return "open"
    if not math.isfinite(end) or not end or not estimate.value:
        return number(end)
    sizes = (math.floor(math.log10(abs(x))) for x in (in_unit(estimate.value, estimate.unit), end))
    return number(end, max(1, digits(estimate) - next(sizes) + next(sizes)))


def spread(estimate: Estimate) -> str:
    """Half the interval over the value; a factor where the interval is wide and lies on one side of zero."""
    half, value = (estimate.high - estimate.low) / 2, estimate.value
    if not value or not math.isfinite(half):
        return DASH
    if estimate.low * estimate.high > 0 and half > WIDE * abs(value):
        ratio = estimate.high / estimate.low
        return f"{FACTOR} {number(math.sqrt(max(ratio, 1 / ratio)), 2)}"
    return f"± {share(abs(half / value), 2)}"


def share(value: float | None, digits: int = 2) -> str:
    """A pure number as percent; what only rounding made is zero."""
    if value is not None and abs(value) < 1e-9:
        return "0 %"
    return typeset(text.percentage(value, digits, zeros=True))


def change(now: float, before: float | None) -> str:
    """How far a value is from the one before."""
    if before is None or before == 0:
        return DASH
    found = 100 * (now / before - 1)
    return f"{'+' if found > 0 else ''}{number(found, 2)} %"


def chance(p: float | None) -> str:
    """A probability."""
    return "< 0.001" if p is not None and p < 1e-3 else number(p, 2)


POOR = 0.2  # NRMSE of training: a machine whose signs, units and levers are right comes far below
CHECK = (
    "Check before you use the numbers: which lever moves which joint, the sign of each command, angle and "
    "flow, the unit of each signal, and the pose from which each recording begins."
)


def warnings(
    refined: RefinementResult,
    names: Mapping[str, str] | None = None,
    signals: Mapping[str, str] | None = None,
) -> list[str]:
    """Whole sentences, the last one with what to check; empty if nothing is doubtful.

    names, signals   parameter and output of the problem -> what the reader calls them
    """
    names, signals = names or {}, signals or {}
    found = []
    if not refined.converged:
        found.append(f"The search did not converge: {refined.reason}.")
    if refined.at_bound:
        ended = ", ".join(names.get(name, name) for name in refined.at_bound)
        found.append(f"At a bound, so not identified: {ended}.")
    poor = {name: share for name, share in _shares(refined).items() if share > POOR}
    if poor:
        worst = sorted(poor, key=lambda name: -poor[name])
        found.append(
            f"The model does not follow even the recordings it was fitted to; above {_percent(POOR)} of the "
            f"range (NRMSE): {', '.join(f'{signals.get(n, n)} {_percent(poor[n])}' for n in worst)}."
        )
    return [*found, CHECK] if found else []


def _shares(refined: RefinementResult) -> dict[str, float]:
    """NRMSE of each output over all training recordings; infinite where a simulation failed.

    Over its largest range: in a recording where a joint rests, the range of its angle is noise.
    """
    found = {}
    for k, name in enumerate(refined.problem.outputs):
        seen = [t for t in refined.training if np.any(t.run.compared[:, k])]
        if seen:
            error = np.concatenate([t.error[t.run.compared[:, k], k] for t in seen])
            size = float(np.sqrt(np.mean(error**2)) / max(t.run.scale[k] for t in seen))
            found[name] = size if np.isfinite(size) else np.inf
    return found


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "(could not be simulated)"


# section 4 and 5 of the paper, in our words
PAPER = {
    5: "valve coefficient over the command",
    6: "pressure drop of a hose over the flow",
    7: "inertance and capacitance of a hose, four groups of records",
    8: "internal and external leakage of the swing motor",
    9: "damping of the swing gear and of the stick cylinder",
    10: "swing: command, angle, speed, flow, pressures",
    11: "stick: command, angle, speed, flow, pressures",
}
SIMULATED = "simulated data (virtual test rig), not FERIC data"
KINDS = {"simulation": SIMULATED, "published": "published data", "measurement": "measured data"}


def origin(kinds: Iterable[str]) -> str:
    """Where the data come from: the words for the kinds of recording, each once."""
    return "; ".join(dict.fromkeys(KINDS.get(kind, kind) for kind in kinds))


def counterpart(number: int) -> str:
    """Which figure of the paper this one corresponds to; nothing for 0."""
    return f"corresponds to Fig. {number} of the paper ({PAPER[number]})" if number in PAPER else ""


def footer(number: int, kinds: Iterable[str]) -> str:
    """The short line inside a picture: it must not travel without its origin."""
    words = [origin(kinds), f"cf. Fig. {number} of the paper" if number in PAPER else ""]
    return " · ".join(word for word in words if word)


def caption(finding: ProcedureResult, kinds: Iterable[str]) -> str:
    """One paragraph: title, origin of the data, the paper's figure."""
    return sentences(finding.title, origin(kinds), counterpart(finding.figure))
