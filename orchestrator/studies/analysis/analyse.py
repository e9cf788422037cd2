"""The analysis of a study: how each output spreads, which runs failed, what moves the output."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import mannwhitneyu

from orchestrator.studies.analysis import morris_sobol, sensitivity
from orchestrator.studies.analysis.results import (
    Analysis,
    Array,
    Failure,
    OutputAnalysis,
    OutputSamples,
    Sensitivity,
    Spread,
    alike,
    done,
    samples,
)
from orchestrator.studies.single_run import OK
from orchestrator.studies.store import Results
from orchestrator.studies.study import START, Output, Study

FEW = 5  # failed runs below which nothing is said about where they lie
EXAMPLES = 5  # numbers of failed runs that are shown for each reason
LEVEL = 0.01  # of the test for where runs fail, over all factors
CONSTANT = 1e-9  # spread over size of an output that counts as constant: a solver's tolerance is larger
NOTES = {
    "morris": "summaries are over the points of the Morris design, where the ends of each range count more",
    "grid": "summaries are over the points of the grid, each as likely",
}


def analyse(results: Results) -> Analysis:
    """Everything that the runs of a study support: a finding for each output, and why runs failed."""
    study = results.study
    notes = [*_missing_factors(results), *_where_failed(results)]
    if study.method in NOTES:
        notes.append(NOTES[study.method])
    return Analysis(
        study.title,
        study.method,
        len(results.table),
        len(done(results)),
        failures(results),
        tuple(_finding(results, output) for output in study.outputs),
        tuple(notes),
    )


def spread(values: Array) -> Spread | None:
    """Distribution of the finite values; None if there are none."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    low, median, high = np.quantile(known, (0.05, 0.5, 0.95)).tolist()
    mean, sd = float(known.mean()), float(known.std(ddof=1)) if known.size > 1 else 0.0
    return Spread(known.size, mean, sd, low, median, high, float(known.min()), float(known.max()))


def failures(results: Results) -> tuple[Failure, ...]:
    """Failed runs by reason, whatever the numbers in it, the most frequent first."""
    failed = results.table[results.table["status"] != OK].sort_values("run")
    reasons = failed["reason"].fillna("").astype(str).where(lambda r: r != "", "no reason given")
    found = []
    for _, group in failed.groupby(alike(reasons), sort=True):
        own, counts = reasons[group.index], {}
        for choice in results.study.compared:
            seen = group[choice.column].astype(str).value_counts()
            counts[choice.name] = {option: int(seen.get(option, 0)) for option in choice.options}
        examples = tuple(int(run) for run in group["run"].head(EXAMPLES))
        found.append(Failure(str(own.iloc[0]), len(group), examples, counts, own.nunique() > 1))
    return tuple(sorted(found, key=lambda failure: (-failure.count, failure.reason)))


def _missing_factors(results: Results) -> list[str]:
    """Factors that some options do not have: there they move nothing."""
    notes = []
    for factor in results.study.factors:
        column = START + factor.name  # missing for a name that stands for several variables
        for choice in results.study.choices if column in results.table else ():
            known = results.table.groupby(choice.column)[column].count()
            lacking = [o for o in choice.options if known.get(o, 0) == 0]
            if lacking and len(lacking) < len(choice.options):
                where = f"{choice.name} {', '.join(lacking)}"
                notes.append(f"{factor.name} is not in {where}: there it moves nothing")
    return notes


def _where_failed(results: Results) -> list[str]:
    """Factors whose values differ between failed and other runs, by the Mann-Whitney test at 1 % in all."""
    failed = (results.table["status"] != OK).to_numpy()
    notes: list[str] = []
    if min(failed.sum(), (~failed).sum()) < FEW:
        return notes
    for factor in results.study.factors:
        values = results.table[factor.column].to_numpy(float)
        bad, good = values[failed], values[~failed]
        test = mannwhitneyu(bad, good)
        if test.pvalue < LEVEL / len(results.study.factors):
            larger = test.statistic > 0.5 * bad.size * good.size
            notes.append(f"runs fail more often at {'large' if larger else 'small'} {factor.name}")
    return notes


def _finding(results: Results, output: Output) -> OutputAnalysis:
    study, ended = results.study, done(results)
    values = ended[output.column].to_numpy(float)
    whole, missing = spread(values), int(np.isnan(values).sum())
    by_choice = {}
    for choice in study.compared:
        column = ended[choice.column].astype(str)
        own = {o: spread(ended.loc[column == o, output.column].to_numpy(float)) for o in choice.options}
        by_choice[choice.name] = {option: value for option, value in own.items() if value is not None}
    constant = False
    found: Sensitivity | str = "no run has this output"
    if whole is not None:
        size = max(abs(whole.maximum), abs(whole.minimum))
        constant = whole.maximum - whole.minimum <= CONSTANT * size
        if constant:
            found = "the output is the same in all runs: nothing moves it"
        elif not study.factors and not study.compared:
            found = "nothing was varied"
        else:
            found = _sensitivity(study, samples(results, output))
    notes = [found] if isinstance(found, str) else []
    if missing and whole is not None:
        notes.append(f"{missing} runs came to their end without this output; they count as failed here")
    return OutputAnalysis(
        output.name,
        output.signal,
        output.measure,
        (output.start, output.stop),
        output.unit,
        whole,
        by_choice,
        constant,
        None if isinstance(found, str) else found,
        tuple(notes),
    )


def _sensitivity(study: Study, found: OutputSamples) -> Sensitivity | str:
    """By the method that the design allows; a reason if there is none."""
    if study.method == "grid":
        result = sensitivity.main_effects(found)
    elif study.method == "morris":
        result = morris_sobol.elementary_effects(found)
    elif study.method != "saltelli":
        result = sensitivity.from_sample(found)
    elif morris_sobol.whole_enough(found):
        result = morris_sobol.sobol_indices(found)
    else:
        result = _from_independent_rows(found)
    if isinstance(result, str):
        return result
    options = {choice.name: choice.options for choice in study.choices}
    effects = tuple(replace(e, options=options.get(e.name, ())) for e in result.effects)
    return replace(result, effects=effects)


def _from_independent_rows(found: OutputSamples) -> Sensitivity | str:
    """Too many runs of a Saltelli design failed, or it is small: its independent rows are a plain sample."""
    width = len(found.names) + 2
    design, count = found.blocks(width)
    kept = len(design.y) // width
    size = f"only {kept} of {count} base samples are complete" if kept < count else f"{count} base samples"
    result = sensitivity.from_sample(morris_sobol.independent(found))
    if isinstance(result, str):
        return f"{size}, too few for a Saltelli design, and {result}"
    why = (
        f"{size}, too few for the estimators of a Saltelli design; this is from those of its rows that are"
        " independent of each other"
    )
    return replace(result, notes=(why, *result.notes))
