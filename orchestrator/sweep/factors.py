"""The numbers of factors as a run sets them: shares become values."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from typing import Any

import pandas as pd

from orchestrator.errors import Problem
from orchestrator.sweep.cases import Case, Options, is_real, values
from orchestrator.sweep.running import Sample
from orchestrator.sweep.study import Factor, Study
from orchestrator.system.system import System


def samples(study: Study, table: pd.DataFrame, cases: dict[Options, Case]) -> Iterator[Sample]:
    """The runs of a study in the order of its table."""
    shares = {o: nominals(study, case.system) for o, case in cases.items()}
    whole = {o: {n for n in shares[o] if not is_real(case.system, n)} for o, case in cases.items()}
    options = [tuple(row) for row in zip(*(table[c.column] for c in study.choices), strict=True)]
    options = options or [()] * len(table)
    columns = {f.name: table[f.column].to_numpy() for f in study.factors}
    for run, chosen in enumerate(options):
        numbers = {n: float(columns[n][run]) * share for n, share in shares[chosen].items()}
        yield Sample(run, chosen, numbers | {n: int(numbers[n]) for n in whole[chosen]})


def nominals(study: Study, system: System) -> dict[str, float]:
    """Factor that the system has -> what its numbers are shares of; 1 where they are values themselves."""
    there = (f for f in study.factors if system.has(f.name))
    return {f.name: nominal(f, system) if f.relative else 1.0 for f in there}


def nominal(factor: Factor, system: System) -> float:
    """The value that a relative factor is a share of, in the unit in which it is given."""
    found: dict[Any, Any] = values(system, factor.name)
    for port, linear in system.targets(factor.name):
        found[port] = (float(found[port]) - linear.offset) / linear.factor
    if len(set(found.values())) > 1:
        each = ", ".join(f"{port} {value:g}" for port, value in found.items())
        raise Problem(f"factors.{factor.name}: a share needs one value, got {each}")
    value = next(iter(found.values()))
    if not isfinite(value) or value == 0.0:
        raise Problem(f"factors.{factor.name}: expected a value to be a share of, got {value:g}")
    return float(value)
