"""Sentences about the results of an analysis; they claim only what the intervals support."""

from __future__ import annotations

from orchestrator.base.text import DisplayUnit, join_words
from orchestrator.studies import study
from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    REGRESSION,
    TOTAL,
    Effect,
    IntervalEstimate,
    OutputAnalysis,
    Sensitivity,
)
from orchestrator.studies.study import short

MEASURES = {name: name for name in study.MEASURES} | {
    "rms": "root mean square",
    "final": "final value",
    "time_of_maximum": "time of the maximum",
}
FRACTIONS = {FIRST: "of its variance by itself", TOTAL: "of its variance", REGRESSION: "of its variance"}
NOTICEABLE = 0.05  # fraction of the variance, or of the largest mu*, from which a factor is mentioned
INTERACTION = 0.1  # fraction of the variance from which interactions are mentioned
CLEAR = 0.3  # rank correlation from which a direction is mentioned
MOST_LEADERS = 3  # with more factors that cannot be distinguished from the first none stands out


def output_description(analysed: OutputAnalysis) -> str:
    """Description of an output, such as `maximum of swing.swing_pressure_a from 1 to 3 s`."""
    start, stop = analysed.window
    window = ""
    if start is not None or stop is not None:
        window = f" from {start or 0:g} s" + (f" to {stop:g} s" if stop is not None else " on")
    return f"{MEASURES[analysed.measure]} of {analysed.signal}{window}"


def sentences(analysed: OutputAnalysis) -> list[str]:
    """Sentences about an output; the first one answers which factors affect it most."""
    if analysed.spread is None:
        return [f"No run has {analysed.name}."]
    spread, text = analysed.spread, analysed.display.text
    median = text(spread.median)
    if analysed.constant:
        return [f"{analysed.name} is {median} in all {spread.runs} runs: no factor has an effect on it."]
    ends = f"{text(spread.low)} and {text(spread.high)}"
    distribution = f"Nine of ten runs lie between {ends}; the median is {median}."
    if analysed.sensitivity is None:
        notes = "; ".join(analysed.notes)
        return [f"The sensitivities of {analysed.name} cannot be estimated: {notes}.", distribution]
    return [*_answer(analysed, analysed.sensitivity), distribution]


def _answer(analysed: OutputAnalysis, sensitivity: Sensitivity) -> list[str]:
    if not sensitivity.reliable:
        fit = 100 * sensitivity.quality.get("r_squared", 0.0)
        return [
            f"The largest effect on {analysed.name} cannot be found from {sensitivity.samples} samples: a"
            f" linear model explains {fit:.0f} % of its variance."
        ]
    effects, measure = sensitivity.effects, sensitivity.measure
    if len(effects) == 1:
        return [f"{effects[0].label} is the only factor that was varied{_direction(analysed, effects[0])}."]
    # the largest effect, and those whose intervals overlap with its interval
    floor = effects[0].estimates[measure].floor
    leaders = [e for e in effects if e.estimates[measure].ceiling >= floor]
    answer = [_first(analysed, effects, leaders, measure)]
    least = NOTICEABLE * (effects[0].estimates[measure].value if measure == MU_STAR else 1.0)
    smaller = [e for e in effects if e not in leaders and e.estimates[measure].floor > 0]
    followers = [e for e in smaller if e.estimates[measure].value >= least]
    if followers and len(leaders) <= MOST_LEADERS:
        sizes = [f"{e.label} {size(e.estimates[measure], measure, analysed.display)}" for e in followers[:4]]
        answer.append(f"Next: {', '.join(sizes)}.")
    interaction = _interaction(sensitivity)
    return [*answer, interaction] if interaction else answer


def _first(analysed: OutputAnalysis, effects: tuple[Effect, ...], leaders: list[Effect], measure: str) -> str:
    """Sentence about the leading factors, or about their absence."""
    top, fraction = effects[0], FRACTIONS.get(measure, "over its range")
    significant = top.estimates[measure].floor > (0.0 if measure == MU_STAR else NOTICEABLE)
    if not significant or len(leaders) > MOST_LEADERS or len(leaders) == len(effects):
        others = len(leaders) - 1
        similar = f"; {others} more cannot be distinguished from it" if others else ""
        largest = size(top.estimates[measure], measure, analysed.display)
        lead = f"the largest is {top.label} with {largest} {fraction}"
        return f"No factor stands out for {analysed.name}: {lead}{similar}."
    names = [e.label for e in leaders]
    sizes = [size(e.estimates[measure], measure, analysed.display) for e in leaders]
    ending = _direction(analysed, top)
    if len(leaders) > 1:
        ending = "; these runs do not show which of them has the larger effect"
    return f"{analysed.name} depends most on {join_words(names)}: {join_words(sizes)} {fraction}{ending}."


def size(estimate: IntervalEstimate, measure: str, unit: DisplayUnit) -> str:
    """An estimate with its interval, such as `61 % (54 to 68)` or `12.1 bar (11 to 13.2)`."""
    if measure == MU_STAR:
        text = unit.text(estimate.value)
        if estimate.low is None:
            return text
        ends = (unit.text(end, with_unit=False) for end in (max(0.0, estimate.floor), estimate.ceiling))
        return f"{text} ({' to '.join(ends)})"
    # A fraction is between 0 and 1, but its estimate can be outside.
    limited = (min(1.0, max(0.0, v)) for v in (estimate.value, estimate.floor, estimate.ceiling))
    percent, least, most = (f"{100 * v:.0f}" for v in limited)
    return f"{percent} %" if estimate.low is None else f"{percent} % ({least} to {most})"


def _direction(analysed: OutputAnalysis, effect: Effect) -> str:
    """Direction of the effect of a factor, or the medians of the options of a choice."""
    if effect.kind == "choice":
        text, options = analysed.display.text, analysed.by_choice[effect.name]
        medians = [f"{text(spread.median)} with {short(option)}" for option, spread in options.items()]
        return f"; its median is {join_words(medians)}" if len(medians) <= MOST_LEADERS else ""
    direction = effect.direction or 0.0
    if abs(direction) < CLEAR:
        return ", without a clear direction"
    return "; it rises with it" if direction > 0 else "; it falls with it"


def _interaction(sensitivity: Sensitivity) -> str:
    """Sentence about interactions, if first-order and total indices show them."""
    if any(FIRST not in e.estimates or TOTAL not in e.estimates for e in sensitivity.effects):
        return ""
    alone = [e.estimates[FIRST] for e in sensitivity.effects]
    remainder, least = 1.0 - sum(e.value for e in alone), 1.0 - sum(e.ceiling for e in alone)
    if remainder < INTERACTION or least <= 0.0:
        return ""
    return f"{100 * remainder:.0f} % of its variance comes from interactions."
