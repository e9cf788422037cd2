"""Analysis of a study: distribution and sensitivity of each output, reasons for failed runs.

The sentences about them claim only what the intervals support.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import mannwhitneyu

from orchestrator.base.signals import moves
from orchestrator.base.text import DisplayUnit, join_words
from orchestrator.data.table import Array
from orchestrator.lanes.group import Status
from orchestrator.studies.analysis import sensitivity
from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    REGRESSION,
    TOTAL,
    Analysis,
    Design,
    Effect,
    IntervalEstimate,
    OutputAnalysis,
    OutputSamples,
    Sensitivity,
    Spread,
    design,
    done,
    failures,
    samples,
)
from orchestrator.studies.store import Results
from orchestrator.studies.study import MEASURES, START, Output, Study, short

FEWEST_RUNS = 5  # fewest failed, and fewest completed, runs for a test of what makes runs fail
SIGNIFICANCE = 0.01  # probability of a false alarm over all factors together (Bonferroni)
NOTES = {
    "morris": "statistics are over the points of the Morris design: ends of ranges have more weight",
    "grid": "statistics are over the points of the grid, with equal weights",
}


def analyse(results: Results) -> Analysis:
    """Analyse all outputs of a study and its failed runs."""
    study = results.study
    notes = [*results.warnings, *_missing_factors(results), *_where_failed(results)]
    if study.method in NOTES:
        notes.append(NOTES[study.method])
    of = design(results)
    findings = tuple(_analyse_output(results, output, of) for output in study.outputs)
    counts = sum(map(len, of[0])), len(done(results))
    return Analysis(study.title, study.method, *counts, failures(results), findings, tuple(notes))


def spread(values: Array) -> Spread | None:
    """Distribution of the finite values; None if there are none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return None
    low, median, high = np.quantile(finite, (0.05, 0.5, 0.95)).tolist()
    mean, sd = float(finite.mean()), float(finite.std(ddof=1)) if finite.size > 1 else 0.0
    return Spread(finite.size, mean, sd, low, median, high, float(finite.min()), float(finite.max()))


def _missing_factors(results: Results) -> list[str]:
    """Notes on factors whose variable does not exist in some options of a choice."""
    notes = []
    for factor in results.study.factors:
        column = START + factor.name
        if column not in results.dataset.schema.names:  # so if the factor sets several variables
            continue
        for choice in results.study.choices:
            values = results.columns(choice.column, column).groupby(choice.column)[column].count()
            lacking = [o for o in choice.options if values.get(o, 0) == 0]
            if lacking and len(lacking) < len(choice.options):
                where = f"{choice.name} {', '.join(lacking)}"
                notes.append(f"{where} has no variable {factor.name}, so the factor has no effect there")
    return notes


def _where_failed(results: Results) -> list[str]:
    """Notes on factors that differ between failed and other runs, by Mann-Whitney tests."""
    failed = (results.columns("status")["status"] != Status.OK).to_numpy()
    notes: list[str] = []
    enough = min(failed.sum(), (~failed).sum()) >= FEWEST_RUNS
    for factor in results.study.factors if enough else ():
        values = results.columns(factor.column)[factor.column].to_numpy(float)
        of_failed, of_others = values[failed], values[~failed]
        test = mannwhitneyu(of_failed, of_others)
        if test.pvalue < SIGNIFICANCE / len(results.study.factors):
            larger = test.statistic > 0.5 * of_failed.size * of_others.size
            notes.append(f"runs fail more often at {'large' if larger else 'small'} {factor.name}")
    return notes


def _analyse_output(results: Results, output: Output, of: Design) -> OutputAnalysis:
    """Distribution of one output over all runs and by option, and its sensitivity."""
    study = results.study
    completed = done(results, output.column, *(c.column for c in study.compared))
    values = completed[output.column].to_numpy(float)
    overall, missing = spread(values), int((~np.isfinite(values)).sum())
    by_choice = {}
    for choice in study.compared:
        column = completed[choice.column].astype(str).to_numpy()
        spreads = ((option, spread(values[column == option])) for option in choice.options)
        by_choice[choice.name] = {option: found for option, found in spreads if found is not None}
    constant = overall is not None and not moves(np.array([overall.minimum, overall.maximum]))
    result: Sensitivity | str
    if overall is None:
        result = "no run has a finite value of this output"
    elif constant:
        result = "the output is the same in all runs"
    elif not study.factors and not study.compared:
        result = "nothing was varied"
    else:
        result = _sensitivity(study, samples(results, output, of))
    notes = [result] if isinstance(result, str) else []
    if missing and overall is not None:
        runs = "1 run" if missing == 1 else f"{missing} runs"
        notes.append(
            f"{runs} finished without a finite value of this output; the sensitivity treats this as a failure"
        )
    what = output.name, output.signal, output.measure, (output.start, output.stop), output.unit
    found = None if isinstance(result, str) else result
    return OutputAnalysis(*what, overall, by_choice, constant, found, tuple(notes))


def _sensitivity(study: Study, data: OutputSamples) -> Sensitivity | str:
    """Sensitivity by the method for the design; a reason if it cannot be estimated."""
    if study.method == "grid":
        result = sensitivity.main_effects(data)
    elif study.method == "morris":
        result = sensitivity.elementary_effects(data)
    elif study.method == "saltelli":
        result = _from_saltelli(data)
    else:
        result = sensitivity.from_sample(data, study.method == "sobol")
    if isinstance(result, str):
        return result
    options = {choice.name: choice.options for choice in study.choices}
    effects = tuple(replace(e, options=options.get(e.name, ())) for e in result.effects)
    return replace(result, effects=effects)


def _from_saltelli(data: OutputSamples) -> Sensitivity | str:
    """Sobol' indices; from the independent rows alone if the design is too small or too many runs failed."""
    width = len(data.names) + 2  # rows of a base sample: A, B and one for each factor
    design, count = data.blocks(width)
    complete = len(design.y) // width
    if complete >= max(sensitivity.LEAST_BASE_SAMPLES, (1 - sensitivity.MOST_MISSING) * count):
        return sensitivity.sobol_indices(design, count)
    size = f"only {complete} of {count} base samples are complete"
    size = size if complete < count else f"{count} base samples"
    result = sensitivity.from_sample(sensitivity.independent(data), sequence=True)
    if isinstance(result, str):
        return f"{size}, too few for a Saltelli design; {result}"
    note = (
        f"{size}, too few for the estimators of a Saltelli design; the estimates use only its rows that are"
        " independent of each other"
    )
    return replace(result, notes=(note, *result.notes))


MEASURE_NAMES = {name: name for name in MEASURES} | {
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
    return f"{MEASURE_NAMES[analysed.measure]} of {analysed.signal}{window}"


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
    shown = FIRST if _overlap(sensitivity) else measure
    answer = [_first(analysed, effects, leaders, measure, shown)]
    least = NOTICEABLE * (effects[0].estimates[measure].value if measure == MU_STAR else 1.0)
    smaller = [e for e in effects if e not in leaders and e.estimates[measure].floor > 0]
    followers = [e for e in smaller if e.estimates[measure].value >= least]
    if followers and len(leaders) <= MOST_LEADERS:
        sizes = [f"{e.label} {size(e.estimates[shown], shown, analysed.display)}" for e in followers[:4]]
        answer.append(f"Next: {', '.join(sizes)}.")
    return [*answer, *filter(None, [_interaction(sensitivity), _overlap(sensitivity)])]


def _first(
    analysed: OutputAnalysis, effects: tuple[Effect, ...], leaders: list[Effect], measure: str, shown: str
) -> str:
    """Sentence about the leading factors by a measure, with the values of another, or about their absence."""
    top, fraction = effects[0], FRACTIONS.get(shown, "over its range")
    significant = top.estimates[measure].floor > (0.0 if measure == MU_STAR else NOTICEABLE)
    if not significant or len(leaders) > MOST_LEADERS or len(leaders) == len(effects):
        others = len(leaders) - 1
        similar = f"; {others} more cannot be distinguished from it" if others else ""
        largest = size(top.estimates[shown], shown, analysed.display)
        lead = f"the largest is {top.label} with {largest} {fraction}"
        return f"No factor stands out for {analysed.name}: {lead}{similar}."
    names = [e.label for e in leaders]
    sizes = [size(e.estimates[shown], shown, analysed.display) for e in leaders]
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


def _overlap(sensitivity: Sensitivity) -> str:
    """Sentence about total indices that count interactions several times, which are no shares; else empty."""
    effects = [e for e in sensitivity.effects if FIRST in e.estimates and TOTAL in e.estimates]
    if sum(e.estimates[TOTAL].value for e in effects) < 1.0 + INTERACTION:
        return ""
    parts = [f"{e.label} {size(e.estimates[TOTAL], TOTAL, DisplayUnit('1', '1'))}" for e in effects[:4]]
    return f"With all interactions: {', '.join(parts)}; these overlap, so they sum to more than 100 %."


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
