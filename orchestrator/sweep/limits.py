"""Numbers of a study against the minimum and maximum that an FMU declares of its variables."""

from __future__ import annotations

from collections.abc import Iterator

from orchestrator.errors import Problem
from orchestrator.sweep.factors import nominal
from orchestrator.sweep.fields import quoted
from orchestrator.sweep.study import Factor, Study
from orchestrator.system.system import System

ENDS = ("minimum", "maximum", "mean", "values")  # a mode lies between its ends, a deviation is no value
ROUNDING = 1e-12  # of a bound: what the conversion of a unit may cost


def limits(study: Study, system: System) -> None:
    """Problem where a number of a factor, or one that is fixed, lies outside what its variable may be.

    Of a normal and a lognormal factor only the mean is looked at, as they have no ends.
    """
    for factor in study.factors:
        if system.has(factor.name):
            share = nominal(factor, system) if factor.relative else 1.0
            for key, number in _numbers(factor):
                told = f" ({number:g} of {share:g})" if factor.relative else ""
                _inside(system, factor.name, f"factors.{quoted(factor.name)}: {key}", number * share, told)
    for name, value in study.fixed.items():
        if system.has(name):
            _inside(system, name, f"fixed: {name}", value)


def _numbers(factor: Factor) -> Iterator[tuple[str, float]]:
    """Key and number of what lies at the ends of a distribution."""
    for key in ENDS:
        found = factor.numbers.get(key, ())
        yield from ((key, number) for number in (found if isinstance(found, tuple) else (found,)))


def _inside(system: System, name: str, where: str, value: float, told: str = "") -> None:
    """Each variable behind a name may have this value."""
    for port, linear in system.targets(name):
        variable, own = system.variable(port), linear(value)
        unit = f" {variable.unit.name}" if variable.unit else ""
        for word, bound, sign in (("least", variable.minimum, 1.0), ("most", variable.maximum, -1.0)):
            if bound is not None and sign * (own - bound) < -ROUNDING * abs(bound):
                raise Problem(f"{where}: expected at {word} {bound:g}{unit}, got {own:g}{unit}{told}")
