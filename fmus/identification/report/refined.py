"""A joint refinement for the page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from fmus.identification.refinement.advice import advice
from fmus.identification.refinement.problem import Problem
from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.starts import Start as Begun
from fmus.identification.refinement.starts import Starts
from fmus.identification.report.content import Fit, Refinement, Start


def refinement(
    refined: Refined,
    names: Mapping[str, str] | None = None,
    signals: Mapping[str, str] | None = None,
    facts: Mapping[str, str] | None = None,
    starts: Starts | None = None,
) -> Refinement:
    """What the page tells of a refinement.

    names, signals   parameter and output of the problem -> what the page calls them
    facts            what else is to be told, such as the time it took
    starts           the same search from random starts
    """
    names, signals = names or {}, signals or {}
    problem, found = refined.problem, refined.statistics
    seconds = sum(float(run.time[-1] - run.time[0]) for run in problem.training)
    told = {
        "recordings": f"{len(problem.training)} for training, {seconds:.0f} s; "
        f"{len(problem.held_out)} held out",
        "iterations": str(len(refined.history)),
        "ended": refined.reason,
        "95 % intervals": "from the scatter between segments: residuals depend on their past, which noise of"
        " sensors does not explain"
        if refined.robust
        else "from the noise of the sensors: residuals are independent of each other",
        **(facts or {}),
    }
    remarks = [*advice(refined), *(f"{names.get(n, n)} ended at its bound." for n in refined.at_bound)]
    return Refinement(
        names=tuple(names.get(n, n) for n in problem.names),
        correlation=found.correlation,
        condition=found.condition,
        fits=tuple(_fit(refined, k, signals.get(n, n)) for k, n in enumerate(problem.outputs)),
        unidentified=tuple(_renamed(sentence, names) for sentence in refined.unidentified),
        starts=tuple(_start(k, one, problem) for k, one in enumerate(starts.starts if starts else (), 1)),
        facts=told,
        remarks=tuple(remarks),
    )


def _fit(refined: Refined, place: int, name: str) -> Fit:
    tests = refined.whiteness[refined.problem.outputs[place]]
    return Fit(
        signal=name,
        train=_mean([float(t.nrmse()[place]) for t in refined.training]),
        test=_mean([float(t.nrmse()[place]) for t in refined.held_out]),
        noise=_known(tests.rms),
        memory=_known(tests.outside),
        white=_known(tests.ljung_box),
        inputs=max(tests.inputs.values(), default=None),
    )


def _mean(values: Sequence[float]) -> float | None:
    """Root mean square over the recordings that have the signal."""
    known = [v for v in values if np.isfinite(v)]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _start(place: int, one: Begun, problem: Problem) -> Start:
    """Distances of where a search began and ended."""
    begun = np.array([f.search(one.begun[f.name]) for f in problem.free])
    away = float(np.sqrt(np.mean((begun - problem.search()) ** 2)))
    return Start(f"random {place}", away, one.apart, one.residual, one.iterations)


def _renamed(sentence: str, names: Mapping[str, str]) -> str:
    """A whole sentence with the page's names; longest first, because one may begin like another."""
    known = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    told = re.sub(rf"\b({known})\b", lambda m: names[m[1]], sentence) if names else sentence
    return told if told.endswith(".") else f"{told}."
