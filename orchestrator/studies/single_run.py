"""One number from a signal over a window of time.

The full set of start values and parameters of each run, as it used them.

One run of a study: a sample becomes a row.

The numbers of factors as a run sets them: shares become values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.units import Linear
from orchestrator.engine.result import Result
from orchestrator.engine.run import run
from orchestrator.fmi.description import Value
from orchestrator.ssp.system import Port, System, coerce
from orchestrator.studies.cases import Case, Options, is_real, signal, values
from orchestrator.studies.study import START, Factor, Output, Study

Signal = NDArray[np.float64]
NAN = float("nan")


def _mean(t: Signal, x: Signal) -> float:
    span = float(t[-1] - t[0])
    return float(np.trapezoid(x, t)) / span if span > 0 else float(x[0])


MEASURES: Mapping[str, Callable[[Signal, Signal], float]] = {
    "maximum": lambda _, x: float(np.max(x)),
    "minimum": lambda _, x: float(np.min(x)),
    "range": lambda _, x: float(np.ptp(x)),
    "final": lambda _, x: float(x[-1]),
    "mean": _mean,
    "rms": lambda t, x: float(np.sqrt(_mean(t, np.square(x)))),
    "integral": lambda t, x: float(np.trapezoid(x, t)),
    "time_of_maximum": lambda t, x: float(t[np.argmax(x)]),
}


def measure(output: Output, time: Signal, signal: Signal) -> float:
    """The number of an output; shapes (n,), time [s]. NaN where the window holds no point.

    Mean, rms and integral are those of straight lines between the points (rms: between the squares). Of
    several points with the largest value the first counts.
    """
    inside = slice(
        0 if output.start is None else int(np.searchsorted(time, output.start - _least(time), "left")),
        len(time) if output.stop is None else int(np.searchsorted(time, output.stop + _least(time), "right")),
    )
    t, x = time[inside], signal[inside]
    return MEASURES[output.measure](t, x) if len(t) else NAN


def _least(time: Signal) -> float:
    """Rounding of a time that is a sum of steps [s]."""
    return 1e-9 * float(time[-1] - time[0]) if len(time) else 0.0


def unit(measure_: str, unit: str) -> str:
    """The unit of a measure of a signal."""
    if measure_ == "time_of_maximum":
        return "s"
    if measure_ != "integral":
        return unit
    return f"{unit}.s" if unit and unit != "1" else "s"


TYPES = {"Real": pa.float64(), "Integer": pa.int64(), "Enumeration": pa.int64(), "Boolean": pa.bool_()}


def starts(study: Study, cases: Mapping[Options, Case], samples: Sequence[Sample]) -> pa.Table:
    """One row per sample; a column `start:component.variable` of each variable that can be set in some case.

    Left out are inputs that a connection or a scenario feeds; null is what a variant does not have.
    """
    places: dict[Options, list[int]] = {options: [] for options in cases}
    for i, sample in enumerate(samples):
        places[sample.options].append(i)
    kinds: dict[Port, pa.DataType] = {}
    columns: dict[Port, list[Any]] = {}
    for options, case in cases.items():
        varied = _varied(study, case.system)
        for port in settable(case):
            variable = case.system.variable(port)
            kinds[port] = TYPES.get(variable.kind, pa.string())
            column = columns.setdefault(port, [None] * len(samples))
            if port in varied:
                name, linear = varied[port]
                for i in places[options]:
                    column[i] = coerce(str(port), variable, samples[i].factors[name], linear)
            else:
                constant = _plain(case.system.components[port.component].value(port.variable))
                for i in places[options]:
                    column[i] = constant
    return pa.table({f"{START}{port}": pa.array(columns[port], kinds[port]) for port in columns})


def settable(case: Case) -> list[Port]:
    """The variables of a case that have a start value of their own."""
    system = case.system
    names = () if case.scenario is None else case.scenario.signals
    fed = {c.target for c in system.connections}
    fed |= {port for name in names if system.has(name) for port, _ in system.targets(name)}
    return [
        Port(c.name, v.name)
        for c in system.components.values()
        for v in c.interface.variables.values()
        if v.settable and Port(c.name, v.name) not in fed
    ]


def units(cases: Mapping[Options, Case]) -> dict[str, str]:
    """Column -> unit, of the FMU."""
    found: dict[str, str] = {}
    for case in cases.values():
        for port in settable(case):
            unit = case.system.variable(port).unit
            found |= {f"{START}{port}": unit.name} if unit else {}
    return found


def _varied(study: Study, system: System) -> dict[Port, tuple[str, Linear]]:
    """Variable -> the factor that sets it, the last that names it, and from its unit to that of the FMU."""
    there = [f.name for f in study.factors if system.has(f.name)]
    return {port: (name, linear) for name in there for port, linear in system.targets(name)}


def _plain(value: Any) -> Any:
    """NaN of an unknown number is no value."""
    return None if isinstance(value, float) and np.isnan(value) else value


OK, EARLY, FAILED = "ok", "early", "failed"


@dataclass(frozen=True)
class Sample:
    """What a run is run with: its number, its options and the numbers of its factors, those it has."""

    run: int
    options: Options
    factors: Mapping[str, Value]


@dataclass(frozen=True)
class Row:
    """What is kept of a run.

    status    ok, early (an FMU asked to end the run), or failed
    reason    in one line, if it is not ok
    outputs   shape (outputs,); NaN of a failed run, and where a window holds nothing
    bands     shape (signals, times), at `band_times`; None of a failed run, or where nothing is kept
    start     time of the first point [s]
    wall      [s]; not part of the results
    """

    run: int
    status: str
    reason: str
    outputs: NDArray[np.float64]
    bands: NDArray[np.float64] | None = None
    start: float = 0.0
    wall: float = 0.0


def failed(study: Study, run: int, reason: str) -> Row:
    """The row of a run that did not come to its end."""
    return Row(run, FAILED, " ".join(reason.split()), np.full(len(study.outputs), NAN))


def row(study: Study, case: Case, sample: Sample) -> Row:
    """Run a sample; whatever goes wrong is its result."""
    try:
        result = _run(study, case, sample)
    except Problem as problem:
        return failed(study, sample.run, str(problem))
    except Exception as defect:  # of this one run; the others go on
        return failed(study, sample.run, f"{type(defect).__name__}: {defect}")
    early = _ended(result)
    return Row(
        run=sample.run,
        status=EARLY if early else OK,
        reason=early,
        outputs=_outputs(study, case, result),
        bands=_bands(study, case, result) if study.bands else None,
        start=float(result.trace.time[0]),
    )


def _run(study: Study, case: Case, sample: Sample) -> Result:
    names = dict.fromkeys(str(signal(case.system, o.signal)) for o in study.outputs)
    return run(
        case.system,
        case.scenario,
        step=study.step,
        stop=study.stop,
        set=sample.factors,
        record=list(names),
        record_step=study.record_step,
        bonds=(),
    )


def _ended(result: Result) -> str:
    """Why a run that stands ended early; empty if it did not."""
    told = [n for n in result.card.notes if n.startswith("the run ends early: ")]
    return " ".join(told[0].removeprefix("the run ends early: ").split()) if told else ""


def _outputs(study: Study, case: Case, result: Result) -> NDArray[np.float64]:
    trace = result.trace
    of = {o.signal: trace[_name(case, o.signal)] for o in study.outputs}
    return np.array([measure(o, trace.time, of[o.signal]) for o in study.outputs], np.float64)


def _bands(study: Study, case: Case, result: Result) -> NDArray[np.float64]:
    """Between the recorded points straight lines; as far as the run came."""
    time = result.trace.time
    count = int((time[-1] - time[0]) / study.band_step + 1e-6) + 1
    times = band_times(study, float(time[0]), count)
    return np.stack([np.interp(times, time, result.trace[_name(case, n)]) for n in study.bands])


def band_times(study: Study, start: float, count: int) -> NDArray[np.float64]:
    """The times [s] at which signals are kept."""
    return np.array([start + study.band_step * k for k in range(count)])


def _name(case: Case, name: str) -> str:
    """A signal as the trace of a run names it: an output of the system by its own name, in its own unit."""
    return name if name in case.system.outputs else str(signal(case.system, name))


def run_values(study: Study, table: pd.DataFrame, cases: dict[Options, Case]) -> Iterator[Sample]:
    """The runs of a study in the order of its table."""
    shares = {o: nominals(study, case.system) for o, case in cases.items()}
    whole = {o: {n for n in shares[o] if not is_real(case.system, n)} for o, case in cases.items()}
    options = [tuple(row) for row in zip(*(table[c.column] for c in study.choices), strict=True)]
    options = options or [()] * len(table)
    columns = {f.name: table[f.column].to_numpy() for f in study.factors}
    for index, chosen in enumerate(options):
        numbers = {n: float(columns[n][index]) * share for n, share in shares[chosen].items()}
        yield Sample(index, chosen, numbers | {n: int(numbers[n]) for n in whole[chosen]})


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
