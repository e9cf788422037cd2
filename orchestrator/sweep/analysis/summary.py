"""How an output spreads over the runs, and which runs failed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy.stats import mannwhitneyu

from orchestrator.sweep.analysis.outcome import Failure, Spread
from orchestrator.sweep.analysis.results import Array, done
from orchestrator.sweep.reasons import alike
from orchestrator.sweep.running import OK
from orchestrator.sweep.store import Results
from orchestrator.sweep.study import START, Output

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
