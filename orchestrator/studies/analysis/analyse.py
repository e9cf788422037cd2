"""Analysis of a study: distribution and sensitivity of each output, and reasons for failed runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import mannwhitneyu

from orchestrator.base.signals import moves
from orchestrator.data.table import Array
from orchestrator.lanes.group import Status
from orchestrator.studies.analysis import morris_sobol, sensitivity
from orchestrator.studies.analysis.output_samples import OutputSamples, done, failures, samples
from orchestrator.studies.analysis.results import Analysis, OutputAnalysis, Sensitivity, Spread
from orchestrator.studies.store import Results
from orchestrator.studies.study import START, Output, Study

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
    findings = tuple(_analyse_output(results, output) for output in study.outputs)
    counts = len(results.table), len(done(results))
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
        if column not in results.table:  # so if the factor sets several variables
            continue
        for choice in results.study.choices:
            values = results.table.groupby(choice.column)[column].count()
            lacking = [o for o in choice.options if values.get(o, 0) == 0]
            if lacking and len(lacking) < len(choice.options):
                where = f"{choice.name} {', '.join(lacking)}"
                notes.append(f"{where} has no variable {factor.name}, so the factor has no effect there")
    return notes


def _where_failed(results: Results) -> list[str]:
    """Notes on factors that differ between failed and other runs, by Mann-Whitney tests."""
    failed = (results.table["status"] != Status.OK).to_numpy()
    notes: list[str] = []
    enough = min(failed.sum(), (~failed).sum()) >= FEWEST_RUNS
    for factor in results.study.factors if enough else ():
        values = results.table[factor.column].to_numpy(float)
        of_failed, of_others = values[failed], values[~failed]
        test = mannwhitneyu(of_failed, of_others)
        if test.pvalue < SIGNIFICANCE / len(results.study.factors):
            larger = test.statistic > 0.5 * of_failed.size * of_others.size
            notes.append(f"runs fail more often at {'large' if larger else 'small'} {factor.name}")
    return notes


def _analyse_output(results: Results, output: Output) -> OutputAnalysis:
    """Distribution of one output over all runs and by option, and its sensitivity."""
    study, completed = results.study, done(results)
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
        result = _sensitivity(study, samples(results, output))
    notes = [result] if isinstance(result, str) else []
    if missing and overall is not None:
        runs = "1 run" if missing == 1 else f"{missing} runs"
        notes.append(
            f"{runs} finished without a finite value of this output; the sensitivity treats this as a failure"
        )
    of = output.name, output.signal, output.measure, (output.start, output.stop), output.unit
    found = None if isinstance(result, str) else result
    return OutputAnalysis(*of, overall, by_choice, constant, found, tuple(notes))


def _sensitivity(study: Study, data: OutputSamples) -> Sensitivity | str:
    """Sensitivity by the method for the design; a reason if it cannot be estimated."""
    if study.method == "grid":
        result = sensitivity.main_effects(data)
    elif study.method == "morris":
        result = morris_sobol.elementary_effects(data)
    elif study.method == "saltelli":
        result = _from_saltelli(data)
    else:
        result = sensitivity.from_sample(data)
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
    if complete >= max(morris_sobol.LEAST_BASE_SAMPLES, (1 - morris_sobol.MOST_MISSING) * count):
        return morris_sobol.sobol_indices(design, count)
    size = f"only {complete} of {count} base samples are complete"
    size = size if complete < count else f"{count} base samples"
    result = sensitivity.from_sample(morris_sobol.independent(data))
    if isinstance(result, str):
        return f"{size}, too few for a Saltelli design; {result}"
    note = (
        f"{size}, too few for the estimators of a Saltelli design; the estimates use only its rows that are"
        " independent of each other"
    )
    return replace(result, notes=(note, *result.notes))
