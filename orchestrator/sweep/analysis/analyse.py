"""The analysis of a study: each output with the method that its design allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.sweep.analysis import given, grids, screening, variance
from orchestrator.sweep.analysis.outcome import Analysis, Finding, Sensitivity
from orchestrator.sweep.analysis.results import Samples, done, samples
from orchestrator.sweep.analysis.summary import absent, by_choice, failures, spread, where_failed
from orchestrator.sweep.store import Results
from orchestrator.sweep.study import Output, Study

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
        return grids.main_effects(found)
    if method == "morris":
        return screening.elementary_effects(found)
    if method != "saltelli":
        return given.from_sample(found)
    if variance.whole_enough(found):
        return variance.sobol_indices(found)
    return _broken(found)


def _broken(found: Samples) -> Sensitivity | str:
    """Too many runs of a Saltelli design failed, or it is small: its independent rows are a plain sample."""
    kept, count = variance.usable(found)
    size = (
        f"only {len(kept)} of {count} base samples are complete"
        if len(kept) < count
        else f"{count} base samples"
    )
    why = (
        f"{size}, too few for the estimators of a Saltelli design; this is from those of its rows that are"
        " independent of each other"
    )
    sensitivity = given.from_sample(variance.independent(found))
    if isinstance(sensitivity, str):
        return f"{size}, too few for a Saltelli design, and {sensitivity}"
    return replace(sensitivity, notes=(why, *sensitivity.notes))
