"""The results of an analysis in sentences, which claim only what the intervals support."""

from __future__ import annotations

from orchestrator.base.text import DisplayUnit, join_words
from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    REGRESSION,
    TOTAL,
    Effect,
    IntervalEstimate,
    OutputAnalysis,
    Sensitivity,
    short,
)

MEASURES = {
    "maximum": "maximum",
    "minimum": "minimum",
    "mean": "mean",
    "rms": "root mean square",
    "range": "range",
    "final": "final value",
    "integral": "integral",
    "time_of_maximum": "time of the maximum",
}
SHARES = {FIRST: "of its variance by itself", TOTAL: "of its variance", REGRESSION: "of its variance"}
NOTICEABLE = 0.05  # share of the variance, or of the largest mu*, below which a factor is not mentioned
TOGETHER = 0.1  # share that factors must move together before it is reported
CLEAR = 0.3  # rank correlation above which a direction is reported
MANY = 3  # factors that cannot be distinguished from the first; with more of them none stands out


def what(finding: OutputAnalysis) -> str:
    """What the output is, such as `maximum of swing.swing_pressure_a from 1 to 3 s`."""
    start, stop = finding.window
    ends = ""
    if start is not None or stop is not None:
        ends = f" from {start or 0:g} s" + (f" to {stop:g} s" if stop is not None else " on")
    return f"{MEASURES[finding.measure]} of {finding.signal}{ends}"


def sentences(finding: OutputAnalysis) -> list[str]:
    """The output in some sentences, the first of them the answer."""
    if finding.spread is None:
        return [f"No run has {finding.name}."]
    spread = finding.spread
    if finding.constant:
        value = finding.display.text(spread.median)
        return [f"{finding.name} is {value} in all {spread.runs} runs: nothing moves it."]
    ends = f"{finding.display.text(spread.low)} and {finding.display.text(spread.high)}"
    where = f"Nine of ten runs lie between {ends}; the median is {finding.display.text(spread.median)}."
    if finding.sensitivity is None:
        return [f"What moves {finding.name} cannot be found: {'; '.join(finding.notes)}.", where]
    return [*_answer(finding, finding.sensitivity), where]


def _answer(finding: OutputAnalysis, sensitivity: Sensitivity) -> list[str]:
    if not sensitivity.reliable:
        fit = 100 * sensitivity.quality.get("r_squared", 0.0)
        return [
            f"What moves {finding.name} most cannot be found from {sensitivity.samples} samples: a linear"
            f" model explains {fit:.0f} % of its variance."
        ]
    effects, measure = sensitivity.effects, sensitivity.measure
    if len(effects) == 1:
        return [f"{effects[0].label} is the only thing that was varied{_direction(finding, effects[0])}."]
    leaders = _leaders(effects, measure)
    answer = [_first(finding, effects, leaders, measure)]
    rest = [e for e in effects if e not in leaders and _counts(e, effects[0], measure)]
    if rest and len(leaders) <= MANY:
        sizes = [f"{e.label} {size(e.estimates[measure], measure, finding.display)}" for e in rest[:4]]
        answer.append(f"Next: {', '.join(sizes)}.")
    together = _together(sensitivity)
    return [*answer, together] if together else answer


def _leaders(effects: tuple[Effect, ...], measure: str) -> list[Effect]:
    """The first, and those whose intervals reach into that of the first."""
    first = effects[0].estimates[measure]
    return [e for e in effects if e.estimates[measure].ceiling >= first.floor]


def _first(finding: OutputAnalysis, effects: tuple[Effect, ...], leaders: list[Effect], measure: str) -> str:
    """Who leads, if anybody does."""
    top, share = effects[0], SHARES.get(measure, "over its range")
    if _none_stands_out(effects, leaders, measure):
        others = len(leaders) - 1
        alike = f"; {others} more cannot be distinguished from it" if others else ""
        largest = size(top.estimates[measure], measure, finding.display)
        lead = f"the largest is {top.label} with {largest} {share}"
        return f"No factor stands out for {finding.name}: {lead}{alike}."
    names = [e.label for e in leaders]
    sizes = [size(e.estimates[measure], measure, finding.display) for e in leaders]
    ending = _direction(finding, top)
    if len(leaders) > 1:
        ending = "; these runs do not show which of them moves it more"
    return f"{finding.name} moves most with {join_words(names)}: {join_words(sizes)} {share}{ending}."


def _none_stands_out(effects: tuple[Effect, ...], leaders: list[Effect], measure: str) -> bool:
    """Many cannot be distinguished from the first, or the first not from nothing."""
    top = effects[0].estimates[measure]
    nothing = 0.0 if measure == MU_STAR else NOTICEABLE
    return top.floor <= nothing or len(leaders) > MANY or len(leaders) == len(effects)


def _counts(effect: Effect, top: Effect, measure: str) -> bool:
    """Whether a factor is worth a word."""
    whole = top.estimates[measure].value if measure == MU_STAR else 1.0
    estimate = effect.estimates[measure]
    return estimate.value >= NOTICEABLE * whole and estimate.floor > 0


def size(estimate: IntervalEstimate, measure: str, unit: DisplayUnit) -> str:
    """An estimate with its interval, such as `61 % (54 to 68)` or `12.1 bar (11 to 13.2)`."""
    if measure == MU_STAR:
        text = unit.text(estimate.value)
        if estimate.low is None:
            return text
        ends = (unit.text(end, with_unit=False) for end in (max(0.0, estimate.floor), estimate.ceiling))
        return f"{text} ({' to '.join(ends)})"
    # a share lies between 0 and 1, an estimate of it need not
    limited = (min(1.0, max(0.0, v)) for v in (estimate.value, estimate.floor, estimate.ceiling))
    percent, least, most = (f"{100 * v:.0f}" for v in limited)
    return f"{percent} %" if estimate.low is None else f"{percent} % ({least} to {most})"


def _direction(finding: OutputAnalysis, effect: Effect) -> str:
    """Whether the output rises or falls with a factor; of a choice its medians."""
    if effect.kind == "choice":
        options = finding.by_choice[effect.name]
        medians = [
            f"{finding.display.text(own.median)} with {short(option)}" for option, own in options.items()
        ]
        return f"; its median is {join_words(medians)}" if len(medians) <= MANY else ""
    direction = effect.direction or 0.0
    if abs(direction) < CLEAR:
        return ", in no one direction"
    return "; it rises with it" if direction > 0 else "; it falls with it"


def _together(sensitivity: Sensitivity) -> str:
    """What factors move only together, if totals and first orders show it."""
    if any(FIRST not in e.estimates or TOTAL not in e.estimates for e in sensitivity.effects):
        return ""
    alone = [e.estimates[FIRST] for e in sensitivity.effects]
    rest, least = 1.0 - sum(e.value for e in alone), 1.0 - sum(e.ceiling for e in alone)
    if rest < TOGETHER or least <= 0.0:
        return ""
    return f"{100 * rest:.0f} % of its variance comes from things acting together, not one by one."
