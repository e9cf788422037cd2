"""The default experiment: there, and possible."""

from __future__ import annotations

import math
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.registry import Table
from orchestrator.check.subject import Element, Subject
from orchestrator.check.unpack import DESCRIPTION

RULES = Table()


def _number(element: Element, name: str) -> float | None:
    try:
        return float(element.get(name))
    except (TypeError, ValueError):
        return None


@RULES.rule("experiment.there", "There is a default experiment with stop time and step size")
def there(subject: Subject) -> Iterator[Finding]:
    if not subject.model.variables:
        return
    element = subject.model.experiment
    if element is None:
        yield note(f"{DESCRIPTION}: no DefaultExperiment; tools guess stop time and step size")
        return
    lacking = [n for n in ("stopTime", "stepSize") if element.get(n) is None]
    if lacking:
        yield note(
            f"{DESCRIPTION} line {element.sourceline}: DefaultExperiment has no {' and no '.join(lacking)}"
        )


@RULES.rule("experiment.values", "The default experiment can be run")
def values(subject: Subject) -> Iterator[Finding]:
    element = subject.model.experiment
    if element is None:
        return
    where = f"{DESCRIPTION} line {element.sourceline}: DefaultExperiment"
    start, stop = _number(element, "startTime") or 0.0, _number(element, "stopTime")
    for name in ("stepSize", "tolerance"):
        value = _number(element, name)
        if value is not None and not (math.isfinite(value) and value > 0):
            yield error(f"{where}: {name} is {value:g}, expected a positive number")
    if stop is not None and not start < stop < math.inf:
        yield error(f"{where}: stopTime {stop:g} is not a time after startTime {start:g}")
    step = _number(element, "stepSize")
    if stop is not None and step is not None and stop > start and step > stop - start:
        yield warning(f"{where}: stepSize {step:g} is longer than the experiment of {stop - start:g} s")


@RULES.rule("experiment.step", "The step size divides the experiment", "FMIKit#133 FMPy#887")
def step(subject: Subject) -> Iterator[Finding]:
    element = subject.model.experiment
    if element is None:
        return
    start, stop = _number(element, "startTime") or 0.0, _number(element, "stopTime")
    size = _number(element, "stepSize")
    if stop is None or size is None or not 0 < size <= stop - start < math.inf:
        return
    count = (stop - start) / size
    # a decimal step is rounded in its last bit, so the count is whole to 1e-9 for up to a million steps
    if not math.isclose(count, round(count), rel_tol=1e-9):
        yield note(
            f"{DESCRIPTION} line {element.sourceline}: {stop - start:g} s are {count:.6g} steps of {size:g} s"
            "; the last step is shorter, or missing"
        )


@RULES.rule("experiment.start", "The default experiment starts at 0", "PyFMI#261 FMPy#638 OpenModelica#11855")
def start(subject: Subject) -> Iterator[Finding]:
    element = subject.model.experiment
    begin = None if element is None else _number(element, "startTime")
    if element is not None and begin:
        yield note(
            f"{DESCRIPTION} line {element.sourceline}: startTime is {begin:g}; some tools start at 0 anyway"
        )
