"""`batch`: simulates many machines that differ in parameters and start values.

Machines of native FMUs of this project run in the vector lanes of all cores (`group`), others one by one in
processes, so that a crash of an FMU ends only one machine (`many`).
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.options import chosen, documented
from orchestrator.base.processes import available_cores, machine_memory
from orchestrator.base.signals import completions, found
from orchestrator.base.text import first_names
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace, dataset
from orchestrator.engine.arguments import BatchArguments
from orchestrator.engine.job import Job
from orchestrator.engine.options import BatchOptions, RunOptions, same
from orchestrator.engine.result import Interrupted
from orchestrator.engine.scenario import ScenarioSource
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.description import Value
from orchestrator.lanes.compiled import LANES, NotInLanes
from orchestrator.lanes.group import Ended, Lanes, Status
from orchestrator.lanes.many import BY_USER, Runs, many
from orchestrator.ssp.masters import MASTERS
from orchestrator.ssp.plausible import doubtful, with_doubts
from orchestrator.ssp.system import Port, System, check_bounds, check_settable

MEMORY_SHARE = 0.5  # of the memory of this computer, for the arrays of a result


@dataclass(frozen=True, eq=False)
class BatchResult(Mapping[str, Array]):
    """The signals of n machines at m points: a mapping of names to values.

    time      shape (m,) [s]
    signals   name -> shape (n, m); NaN after the end of a machine that ended early
    status    of each machine: "ok", "unreliable" (the error of the coupling is too large), "early" (an FMU
              asked for the end), "failed" or "interrupted", shape (n,)
    reasons   why the status of each machine is not "ok"; empty if it is
    units     name -> unit of the FMU
    notes     remarks, such as why the machines ran one by one
    wall      wall time of the simulation [s]
    """

    time: Array
    signals: Mapping[str, Array]
    status: NDArray[np.str_]
    reasons: Sequence[str]
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    wall: float = 0.0

    def __repr__(self) -> str:
        counts = ", ".join(f"{(self.status == word).sum()} {word}" for word in np.unique(self.status))
        size = f"{len(self.signals)} signals at {len(self.time)} times in {self.wall:.3g} s"
        head = f"BatchResult: {len(self.status)} machines ({counts}), {size}"
        return f"{head}\nsignals: {first_names(self.signals)}"

    def __getitem__(self, name: str) -> Array:
        return self.signals[found(self.signals, name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)

    def _ipython_key_completions_(self) -> list[str]:
        return completions(self.signals)

    def to_xarray(self) -> Any:
        """A dataset of the signals over `machine` and `time`, and the status of each machine."""
        return dataset(self.time, self.signals, self.units, {"status": self.status})

    def trace(self, machine: int) -> Trace:
        """The signals of one machine, up to its failure."""
        finite = [np.isfinite(signal[machine]) for signal in self.signals.values()]
        gaps = np.flatnonzero(~np.all(finite, axis=0))
        points = int(gaps[0]) if gaps.size else len(self.time)
        signals = {name: signal[machine, :points] for name, signal in self.signals.items()}
        return Trace(self.time[:points], signals, self.units)


@documented(BatchArguments)
def batch(
    system: System | str | Path,
    values: Mapping[str, ArrayLike],
    scenario: ScenarioSource = None,
    *,
    record: str | Sequence[str] | None = None,
    lanes: bool | None = None,
    **options: Unpack[BatchArguments],
) -> BatchResult:
    """Co-simulate n machines that differ in parameters or start values.

    values       name -> n values in the unit of the FMU; names as in `set`
    record       recorded signals; default: all outputs
    lanes        True: only in the vector lanes, else NotInLanes; False: one by one; default: in lanes if the
                 FMUs are native FMUs of this project, and the compiler is installed

    The options hold for all machines. A machine that fails does not stop the others. Raises Interrupted
    with the result until an interrupt, and Problem for a mistake.

        from orchestrator import batch

        masses = {"manipulator.head_mass": [300.0, 350.0, 400.0]}
        result = batch("build/harvester.ssp", masses, stop=10.0, record=["manipulator.swing_angle"])
        print(result["manipulator.swing_angle"][:, -1])  # [rad], of each machine
    """
    given = chosen(BatchOptions, options, "batch")
    workers = given.workers or available_cores()
    recorded = (record,) if isinstance(record, str) else record and tuple(record)
    job = Job.of(system, scenario, same(RunOptions, given, record=recorded))
    if job.coupling.method.own:
        got = f"got {job.coupling.method.name}, whose functions are in the calling process"
        raise Problem(f"batch: expected one of the masters {', '.join(MASTERS)}, {got}")
    times = job.times
    if times.free:
        raise Problem(
            "batch: expected a record step for adaptive steps, so that all machines have the same points"
        )
    arrays_in, count = machine_values(job, values)
    names = map(str, job.system.ports("output")) if job.signals is None else job.signals
    signals = {name: job.system.port(name) for name in names}
    rows = _allocate(signals, count, times.rows)
    began = time.perf_counter()
    units = {name: unit.name for name, p in signals.items() if (unit := job.system.variable(p).unit)}
    doubts = [doubtful(job.system, port, (v.min(), v.max())) for port, v in arrays_in.items()]
    warnings = with_doubts(job.system, doubts).warnings
    arrays = dict(zip(signals, rows, strict=True))

    def result(ended: Mapping[int, Ended], notes: tuple[str, ...]) -> BatchResult:
        status = np.array([ended[i].status if i in ended else Status.OK for i in range(count)])
        reasons = [ended[i].reason if i in ended else "" for i in range(count)]
        doubted = [i for i in range(count) if status[i] == Status.NOT_RELIABLE]
        told = [f"{len(doubted)} of {count} machines: {reasons[doubted[0]]}"] if doubted else []
        every = (*told, *job.system.notes, *warnings, *times.notes, *notes)
        wall = time.perf_counter() - began
        return BatchResult(recorded_times(times), arrays, status, reasons, units, every, wall)

    ports, notes = [*signals.values()], tuple[str, ...]()
    try:
        if lanes is not False:
            try:
                together = Lanes(job, ports)
                return result(run_machines(job, together, arrays_in, count, ports, rows, workers), ())
            except NotInLanes as reason:
                if lanes:
                    raise
                notes = (f"the machines ran one by one: {reason}",)
        return result(run_machines(job, None, arrays_in, count, ports, rows, workers), notes)
    except KeyboardInterrupt:
        unfinished = {i for row in rows for i in np.flatnonzero(np.isnan(row[:, -1])).tolist()}
        raise Interrupted(result(dict.fromkeys(unfinished, BY_USER), ())) from None


# ---- what differs and what is recorded


def machine_values(
    job: Job, parameters: Mapping[str, ArrayLike], count: int | None = None
) -> tuple[dict[Port, Array], int]:
    """The value of each variable for each machine, in the unit of the FMU, and the number of machines.

    count   number of machines, if it is known
    """
    if not parameters and count is None:
        raise Problem("values: expected a name with a value for each machine, got none")
    driven = job.scenario.columns if job.scenario else {}
    connected = {c.target: c for c in job.system.connections}
    values: dict[Port, Array] = {}
    names: dict[Port, str] = {}
    first = ""
    for name, given in parameters.items():
        array = _numbers(name, given)
        first = first or name
        count = len(array) if count is None else count
        if len(array) != count:
            expected = f"{count} values" + (f", as {first} has" if name != first else "")
            raise Problem(f"values: {name}: expected {expected}, got {len(array)}")
        for port, linear in job.system.targets(name):
            if port in connected:
                raise Problem(f"values: {name}: the input is connected ({connected[port]})")
            if port in driven:
                raise Problem(f"values: {name}: the scenario drives {port}")
            if port in names:
                raise Problem(f"values: {port} is set twice, by {names[port]} and {name}")
            check_settable(port, job.system.components[port.component].interface)
            names[port], values[port] = name, linear.factor * array + linear.offset
            for value in (values[port].min(), values[port].max()):
                check_bounds(f"values: {name}", job.system.variable(port), float(value))
        job.system.check_sets_all(name, "values")
    return values, count or 0


def _numbers(name: str, given: ArrayLike) -> Array:
    try:
        array = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise Problem(f"values: {name}: expected numbers, got {given!r}"[:200]) from None
    if array.ndim != 1 or not len(array):
        raise Problem(f"values: {name}: expected one value for each machine, got the shape {array.shape}")
    if not np.isfinite(array).all():
        i = int(np.argmin(np.isfinite(array)))
        raise Problem(f"values: {name}: expected finite numbers, got {array[i]} for machine {i}")
    return array


def recorded_times(times: Grid) -> Array:
    """The recorded points [s], shape (m,)."""
    points = np.unique([*range(0, times.steps + 1, times.every), times.steps])
    return times.start + points * times.step


def _allocate(signals: Mapping[str, Port], count: int, points: int) -> list[Array]:
    """An array for each signal, shape (machines, points)."""
    size = 8.0 * len(signals) * count * points
    if size > MEMORY_SHARE * machine_memory():
        expected = f"expected at most {MEMORY_SHARE * machine_memory() / 1e9:.3g} GB"
        advice = "choose fewer signals by record or a longer record_step"
        raise Problem(
            f"batch: {len(signals)} signals of {count} machines at {points} points: {expected}, "
            f"got {size / 1e9:.3g} GB; {advice}"
        )
    return [np.full((count, points), np.nan) for _ in signals]


# ---- the runs


def run_machines(
    job: Job,
    lanes: Lanes | None,
    values: Mapping[Port, Array],
    count: int,
    signals: Sequence[Port],
    rows: Sequence[Array],
    workers: int,
) -> dict[int, Ended]:
    """Simulate n machines, in lanes or each in a process; returns those that ended early or are not reliable.

    values   of all machines, shape (n,), in the unit of the FMU
    rows     one array for each signal of all machines, shape (n, points), which is filled
    """
    ended, points = dict[int, Ended | None](), recorded_times(job.times)
    job = replace(job, options=replace(job.options, record=tuple(map(str, signals))))
    with closing(Runs([] if lanes else [job.system])) as runs:
        job = job if lanes else replace(job, system=runs.systems[0])

        def work(first: int) -> Iterable[tuple[int, Ended | None]]:
            if lanes:
                group = runs.together(lanes, values, rows, first, count, job)
                return enumerate((end for _, end in group), first)
            start = {port: float(array[first]) for port, array in values.items()}
            result, end = runs.alone(replace(job, system=_with_values(job.system, start)))
            if result is not None and len(result.time):
                length = min(len(result.time), len(points))
                recorded = job.times.aligned(result.time[:length]) == points[:length]
                for row, name in zip(rows, job.signals or (), strict=True):
                    row[first, :length][recorded] = result.trace[name][:length][recorded]
            return [(first, end)]

        firsts = range(0, count, LANES if lanes else 1)
        many(work, firsts, lambda found: ended.update(chain(*found)), runs.stop, workers)
    return {machine: end for machine, end in ended.items() if end}


def _with_values(system: System, values: Mapping[Port, float]) -> System:
    """The system with other start values, in the units of the FMUs."""
    start: dict[str, dict[str, Value]] = {name: {} for name in ("", *system.components)}
    for port, value in values.items():
        start[port.component][port.variable] = value if system.variable(port).is_real else round(value)
    return system.started(start, "")
