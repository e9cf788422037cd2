"""`batch`: simulates many machines that differ in parameters and start values.

Machines of native FMUs of this project run in the vector lanes of all cores (`group`), others one by one in
processes, so that a crash of an FMU ends only one machine (`many`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
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
from orchestrator.lanes.many import BY_USER, ClusterLost, Runs, archives_of, compiles, many
from orchestrator.ssp.masters import MASTERS
from orchestrator.ssp.plausible import doubtful, with_doubts
from orchestrator.ssp.system import Port, System, check_bounds, check_settable

if TYPE_CHECKING:
    from distributed import Client

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
    client: Client | None = None,
    **options: Unpack[BatchArguments],
) -> BatchResult:
    """Co-simulate n machines that differ in parameters or start values.

    values       name -> n values in the unit of the FMU; names as in `set`
    record       recorded signals; default: all outputs
    lanes        True: only in the vector lanes, else NotInLanes; False: one by one; default: in lanes if the
                 FMUs are native FMUs of this project, and the compiler is installed
    client       a connection to a Dask cluster for the machines, which stays open; not with `workers`

    The options hold for all machines. A machine that fails does not stop the others. Raises Interrupted
    with the result until an interrupt, and Problem for a mistake.

        from orchestrator import batch

        masses = {"manipulator.head_mass": [300.0, 350.0, 400.0]}
        result = batch("build/harvester.ssp", masses, stop=10.0, record=["manipulator.swing_angle"])
        print(result["manipulator.swing_angle"][:, -1])  # [rad], of each machine
    """
    given = chosen(BatchOptions, options, "batch")
    if given.workers and client:
        raise Problem("batch: workers: expected none with a client, whose cluster has its own")
    where = client or given.workers or available_cores()
    recorded = None if record is None else (record,) if isinstance(record, str) else tuple(record)
    job = Job.of(system, scenario, replace(same(RunOptions, given), record=recorded))
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
                if not compiles(where):
                    raise NotInLanes("a worker of the cluster has no compiler")
                together = Lanes(job, ports)
                return result(run_machines(job, together, arrays_in, count, ports, rows, where), ())
            except NotInLanes as reason:
                if lanes:
                    raise
                notes = (f"the machines ran one by one: {reason}",)
        return result(run_machines(job, None, arrays_in, count, ports, rows, where), notes)
    except (KeyboardInterrupt, ClusterLost) as end:
        why = Ended(Status.FAILED, str(end)) if isinstance(end, ClusterLost) else BY_USER
        unfinished = {i for row in rows for i in np.flatnonzero(np.isnan(row[:, -1])).tolist()}
        told = result(dict.fromkeys(unfinished, why), ())
        if isinstance(end, ClusterLost):  # the machines that are done are complete
            return told
        raise Interrupted(told) from None


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


Task = tuple[int, Mapping[Port, Array]]  # number of the first machine, and the values of those run together


class MachineRuns:
    """The runs of machines of a job: each in a process, or groups in lanes.

    rows       one array for each signal of all machines, shape (n, points), which is filled; None: the rows
               of a task are part of its outcome
    archives   see `archives_of`
    """

    def __init__(
        self,
        job: Job,
        signals: Sequence[Port],
        lanes: Lanes | None,
        rows: Sequence[Array] | None = None,
        archives: Mapping[Location, bytes] | None = None,
    ) -> None:
        self._given, self._lanes, self._rows = (job, signals), lanes, rows
        self._runs = Runs([] if lanes else [job.system], archives)
        (system,) = self._runs.systems or [job.system]
        self._job = replace(job, system=system, options=replace(job.options, record=tuple(map(str, signals))))
        self._points, self.stop, self.close = recorded_times(job.times), self._runs.stop, self._runs.close

    @classmethod
    def opened(
        cls, job: Job, signals: Sequence[Port], archives: Mapping[Location, bytes], in_lanes: bool, end: float
    ) -> MachineRuns:
        """Those of another computer; end: of the time limit, by the clock that computers share [s]."""
        job = replace(job, deadline=time.monotonic() + end - time.time())
        runs = cls(job, signals, None, None, archives)
        try:
            runs._lanes = Lanes(runs._job, signals, generated=True) if in_lanes else None
        except BaseException:
            runs.close()
            raise
        return runs

    def __reduce__(self) -> tuple[Any, ...]:
        """Opened anew, with the FMUs as bytes."""
        (job, signals), end = self._given, time.time() + self._job.deadline - time.monotonic()
        return MachineRuns.opened, (job, signals, archives_of([job.system]), self.compiled, end)

    @property
    def compiled(self) -> bool:
        """Are they in lanes?"""
        return self._lanes is not None

    def run(self, task: Task) -> tuple[int, list[Ended | None], list[Array] | None]:
        """The number of the first machine, how each ended, and the rows if nobody else has them."""
        first, values = task
        count, job = len(next(iter(values.values()))), self._job
        if self._rows is None:
            rows = [np.full((count, len(self._points)), np.nan) for _ in job.signals or ()]
        else:
            rows = [row[first : first + count] for row in self._rows]
        if self._lanes:
            group = self._runs.together(self._lanes, values, rows, 0, count, job)
            ended = [end for _, end in group]
        else:
            start = {port: float(array[0]) for port, array in values.items()}
            result, end = self._runs.alone(replace(job, system=_with_values(job.system, start)))
            ended, points = [end], self._points
            if result is not None and len(result.time):
                length = min(len(result.time), len(points))
                recorded = job.times.aligned(result.time[:length]) == points[:length]
                for row, name in zip(rows, job.signals or (), strict=True):
                    row[0, :length][recorded] = result.trace[name][:length][recorded]
        return first, ended, rows if self._rows is None else None

    def lost(self, task: Task, reason: str) -> tuple[int, list[Ended | None], None]:
        """The outcome of machines that cannot be run."""
        first, values = task
        return first, [Ended(Status.FAILED, reason)] * len(next(iter(values.values()))), None


def run_machines(
    job: Job,
    lanes: Lanes | None,
    values: Mapping[Port, Array],
    count: int,
    signals: Sequence[Port],
    rows: Sequence[Array],
    where: int | Client,
) -> dict[int, Ended]:
    """Simulate n machines, in lanes or each in a process; returns those that ended early or are not reliable.

    values   of all machines, shape (n,), in the unit of the FMU
    rows     one array for each signal of all machines, shape (n, points), which is filled
    """
    ended, together = dict[int, Ended | None](), LANES if lanes else 1

    def keep(found: list[tuple[int, list[Ended | None], list[Array] | None]]) -> None:
        for first, ends, new in found:
            ended.update(enumerate(ends, first))
            for row, part in zip(rows, new or (), strict=new is not None):
                row[first : first + len(ends)] = part

    firsts = range(0, count, together)
    tasks = [(i, {port: array[i : i + together] for port, array in values.items()}) for i in firsts]
    with closing(MachineRuns(job, signals, lanes, rows)) as runs:
        many(runs, tasks, keep, where)
    return {machine: end for machine, end in ended.items() if end}


def _with_values(system: System, values: Mapping[Port, float]) -> System:
    """The system with other start values, in the units of the FMUs."""
    start: dict[str, dict[str, Value]] = {name: {} for name in ("", *system.components)}
    for port, value in values.items():
        start[port.component][port.variable] = value if system.variable(port).is_real else round(value)
    return system.started(start, "")
