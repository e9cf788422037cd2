"""How an output spreads over the runs, and which runs failed.

The analysis of a study: each output with the method that its design allows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.stats import mannwhitneyu

from orchestrator.studies.analysis import morris_sobol, sensitivity
from orchestrator.studies.analysis.results import (
    Analysis,
    Array,
    Failure,
    Finding,
    Samples,
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


def spread(values: Array) -> Spread | None:
    """Of the numbers that are there."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    low, median, high = (float(q) for q in np.quantile(known, (0.05, 0.5, 0.95)))
    sd = float(known.std(ddof=1)) if known.size > 1 else 0.0
    return Spread(
        known.size, float(known.mean()), sd, low, median, high, float(known.min()), float(known.max())
    )


def by_choice(results: Results, output: Output) -> dict[str, dict[str, Spread]]:
    """Option by option; options without a number are left out."""
    ended, found = done(results), {}
    for choice in results.study.compared:
        column = ended[choice.column].astype(str)
        own = {o: spread(ended.loc[column == o, output.column].to_numpy(float)) for o in choice.options}
        found[choice.what] = {option: value for option, value in own.items() if value is not None}
    return found


def failures(results: Results) -> tuple[Failure, ...]:
    """By reason, whatever the numbers in it, the most frequent first."""
    failed = results.table[results.table["status"] != OK]
    found = []
    told = failed["reason"].fillna("").astype(str).where(lambda reason: reason != "", "no reason given")
    for _, group in failed.sort_values("run").groupby(alike(told), sort=True):
        own = told[group.index]
        counts = {c.what: _counts(group[c.column], c.options) for c in results.study.compared}
        runs = tuple(int(run) for run in group["run"].head(5))
        found.append(Failure(str(own.iloc[0]), len(group), runs, counts, own.nunique() > 1))
    return tuple(sorted(found, key=lambda failure: (-failure.count, failure.reason)))


def _counts(column: pd.Series, options: tuple[str, ...]) -> Mapping[str, int]:
    seen = column.astype(str).value_counts()
    return {option: int(seen.get(option, 0)) for option in options}


def absent(results: Results) -> tuple[str, ...]:
    """Factors that some options do not have: there they move nothing."""
    found = []
    for factor in results.study.factors:
        column = START + factor.name  # not there for a name that stands for several variables
        if column not in results.table:
            continue
        for choice in results.study.choices:
            known = results.table.groupby(choice.column)[column].count()
            lacking = [o for o in choice.options if known.get(o, 0) == 0]
            if lacking and len(lacking) < len(choice.options):
                found.append(
                    f"{factor.name} is not in {choice.what} {', '.join(lacking)}: there it moves nothing"
                )
    return tuple(found)


def where_failed(results: Results) -> tuple[str, ...]:
    """Factors whose values differ between failed and other runs, by Mann and Whitney's test at 1 % in all."""
    failed = (results.table["status"] != OK).to_numpy()
    if min(failed.sum(), (~failed).sum()) < FEW:
        return ()
    found = []
    for factor in results.study.factors:
        values = results.table[factor.column].to_numpy(float)
        bad, good = values[failed], values[~failed]
        test = mannwhitneyu(bad, good)
        if test.pvalue < 0.01 / len(results.study.factors):
            larger = test.statistic > 0.5 * bad.size * good.size
            found.append(f"runs fail more often at {'large' if larger else 'small'} {factor.name}")
    return tuple(found)


# An output whose spread is below this share of its size is constant: a solver's tolerance is larger.
CONSTANT = 1e-9


def analyse(results: Results) -> Analysis:
    """Everything that the numbers of the study's runs support."""
    study = results.study
    notes = [*absent(results), *where_failed(results)]
    if study.method == "morris":
        notes.append(
            "summaries are over the points of the Morris design, where the ends of each range count more"
        )
    if study.method == "grid":
        notes.append("summaries are over the points of the grid, each as likely")
    return Analysis(
        study.title,
        study.method,
        len(results.table),
        len(done(results)),
        failures(results),
        tuple(_finding(results, output) for output in study.outputs),
        tuple(notes),
    )


def _finding(results: Results, output: Output) -> Finding:
    values = done(results)[output.column].to_numpy(float)
    whole = spread(values)
    constant = whole is not None and whole.maximum - whole.minimum <= CONSTANT * max(
        abs(whole.maximum), abs(whole.minimum)
    )
    sensitivity: Sensitivity | str = "no run has this output"
    if constant:
        sensitivity = "the output is the same in all runs: nothing moves it"
    elif whole is not None and not results.study.factors and not results.study.compared:
        sensitivity = "nothing was varied"
    elif whole is not None:
        sensitivity = _sensitivity(results.study.method, samples(results, output))
    missing = int(np.isnan(values).sum())
    notes = [sensitivity] if isinstance(sensitivity, str) else []
    if missing and whole is not None:
        notes.append(f"{missing} runs came to their end without this output; they count as failed here")
    return Finding(
        output.name,
        output.signal,
        output.measure,
        (output.start, output.stop),
        output.unit,
        whole,
        by_choice(results, output),
        constant,
        None if isinstance(sensitivity, str) else _with_options(sensitivity, results.study),
        tuple(notes),
    )


def _with_options(sensitivity: Sensitivity, study: Study) -> Sensitivity:
    """Choices know their options, for a reader."""
    options = {choice.what: choice.options for choice in study.choices}
    effects = tuple(replace(e, options=options.get(e.name, ())) for e in sensitivity.effects)
    return replace(sensitivity, effects=effects)


def _sensitivity(method: str, found: Samples) -> Sensitivity | str:
    """By the design that was run."""
    if method == "grid":
        return sensitivity.main_effects(found)
    if method == "morris":
        return morris_sobol.elementary_effects(found)
    if method != "saltelli":
        return sensitivity.from_sample(found)
    if morris_sobol.whole_enough(found):
        return morris_sobol.sobol_indices(found)
    return _broken(found)


def _broken(found: Samples) -> Sensitivity | str:
    """Too many runs of a Saltelli design failed, or it is small: its independent rows are a plain sample."""
    kept, count = morris_sobol.usable(found)
    size = (
        f"only {len(kept)} of {count} base samples are complete"
        if len(kept) < count
        else f"{count} base samples"
    )
    why = (
        f"{size}, too few for the estimators of a Saltelli design; this is from those of its rows that are"
        " independent of each other"
    )
    found_by_regression = sensitivity.from_sample(morris_sobol.independent(found))
    if isinstance(found_by_regression, str):
        return f"{size}, too few for a Saltelli design, and {found_by_regression}"
    return replace(found_by_regression, notes=(why, *found_by_regression.notes))
