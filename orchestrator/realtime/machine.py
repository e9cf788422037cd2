"""The machine in real time, seen from the parent process: it sends commands and reads frames."""

import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.processes import machine_memory
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace
from orchestrator.realtime.deadlines import latency_quantile, speed_factor
from orchestrator.realtime.setup import Frame, Setup, State, Task, Timing
from orchestrator.realtime.shared_memory import Command, MachineStatus, Memory, SharedState, layout
from orchestrator.worker.process import Worker

KEPT = 1800.0  # [s]; frames of this time are kept
MOST = 256 << 20  # bytes of memory for frames, at most
MARGIN = 200  # oldest frames that are not read, because they may be overwritten meanwhile
SILENT = 5.0  # [s] without a heartbeat, after which an FMU counts as hanging
START_TIMEOUT = 60.0  # [s] from the start of a process to its first frame
MEMORY = machine_memory() / 2  # bytes; a machine that takes more would soon stop for lack of memory
END_TIMEOUT = 0.7  # [s] for an orderly end, after which the process is killed: Ctrl-C is obeyed within 2 s


class MachineProcess:
    """The process of one start of a machine, with shared memory for its frames.

    worker   the process
    shared   the shared memory; readable even after the process has ended
    closed   True after `close`
    """

    def __init__(self, setup: Setup, first: int, serial: int) -> None:
        """first: number of the first frame; serial: of the last command that is not for this process."""
        self.setup, self.first, self.closed = setup, first, False
        self.axes = tuple(axis.name for axis in setup.axes)
        sizes = len(setup.axes), len(setup.signals)
        rows = max(2, min(int(KEPT / setup.frame), MOST // layout(*sizes, 1)["frames"].itemsize))
        memory = Memory(layout(*sizes, rows).itemsize)
        self.shared = SharedState(memory.map, *sizes, rows)
        target = "orchestrator.realtime.stepping:main"
        self.worker = Worker(target, dict, "live", END_TIMEOUT, descriptors=memory.descriptors)
        self.worker.fmus = str(setup.system)
        memory.handed_over()
        self.worker.put(Task(setup, memory.address, rows, first, serial))
        self._began = self._heard = time.monotonic()
        self._heartbeat = -1
        self._failure = ""

    def close(self) -> None:
        """End the process. May be repeated; a failure before or at the end stays the state."""
        if self.closed:
            return
        state, message = self._state(self.shared.status())
        began = time.monotonic()
        self.worker.close()
        if state == State.FAILED:
            self._failure = message
        elif self.shared.status().state != State.ENDED:  # the FMUs are not closed
            late = time.monotonic() - began > END_TIMEOUT
            told = f"did not end within {END_TIMEOUT:g} s, stopped"
            cause = told if late else f"ended: {self.worker.ending}"
            self._failure = f"the process of the machine {cause} {self.worker.where}"
        self.closed = True

    @property
    def units(self) -> Mapping[str, str]:
        """Units of axes and signals; empty until the machine is ready."""
        return dict(_details(self.shared.status()).get("units", {}))

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the run, on lost time, and on frames that are no longer kept."""
        status = self.shared.status()
        notes = [str(note) for note in _details(status).get("notes", ())]
        if status.slipped > 0:
            slower = "the simulation was slower than real time"
            notes.append(f"{slower}: its clock was stopped for {status.slipped:.3g} s")
        if (lost := self._oldest(status) - self.first) > 0:
            notes.append(f"the first {lost} frames are no longer in memory")
        return tuple(notes)

    def latest(self) -> Frame:
        """The latest frame; NaN before the first one."""
        status, frames = self.shared.status(), self.shared.frames
        _, t, axes, values = frames[status.last % len(frames)].copy().item()
        if status.last < self.first:
            t, axes, values = np.nan, axes + np.nan, values + np.nan
        state, message = self._state(status)
        median, p99 = (min(latency_quantile(status.latencies, q), status.worst) for q in (0.5, 0.99))
        timing = Timing(status.frames, status.missed, (median, p99, status.worst), status.load)
        number = max(status.last, self.first - 1)
        return Frame(number, t, axes, values, state, message, timing)

    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Numbers (n,), times (n,), axes (n, axes), values (n, signals) of the frames after a number."""
        status = self.shared.status()
        begin = max(number + 1, self._oldest(status))
        numbers = np.arange(begin, max(status.last + 1, begin))
        frames = self.shared.frames[numbers % len(self.shared.frames)]
        valid = frames["number"] == numbers  # False if overwritten in the meantime
        numbers, frames = numbers[valid], frames[valid]
        return numbers, frames["time"], frames["axes"], frames["values"]

    def trace(self) -> Trace:
        """Axes and signals over time, of all frames in memory."""
        _, times, axes, values = self.since(-1)
        table = dict(zip(self.axes, np.ascontiguousarray(axes.T), strict=True))
        table |= dict(zip(self.setup.signals, np.ascontiguousarray(values.T), strict=True))
        return Trace(np.ascontiguousarray(times), table, self.units)

    def _oldest(self, status: MachineStatus) -> int:
        """Number of the oldest frame in memory."""
        room = len(self.shared.frames)
        full = status.last - self.first >= room
        return status.last - room + 1 + min(MARGIN, room // 4) if full else self.first

    def _state(self, status: MachineStatus) -> tuple[State, str]:
        """State and message. A process has failed if it ends, takes too much memory or does not answer."""
        if status.state == State.FAILED:
            lost = f"an FMU wrote over the memory of the machine {self.worker.where}"
            return State.FAILED, str(_details(status).get("message", lost))
        self.worker.cut_printed()
        if not self._failure and self.worker.memory > MEMORY:
            most = f"{MEMORY / 1e9:.3g} GB of memory"
            self._failure = f"the machine uses more than {most}, stopped {self.worker.where}"
            self.worker.close()
        if self._failure:
            return State.FAILED, self._failure
        if self.closed:
            return State.ENDED, ""
        if ending := self.worker.ending:
            return State.FAILED, f"the process of the machine ended: {ending} {self.worker.where}"
        return self._heard_of(status)

    def _heard_of(self, status: MachineStatus) -> tuple[State, str]:
        """State and message by the last sign of life."""
        now, starting = time.monotonic(), status.state == State.STARTING
        if starting and now - self._began > START_TIMEOUT:
            self._failure = f"the machine has not started within {START_TIMEOUT:g} s {self.worker.where}"
            self.worker.close()
            return State.FAILED, self._failure
        if starting or status.heartbeat != self._heartbeat:
            self._heartbeat, self._heard = status.heartbeat, now
        if (silent := now - self._heard) > SILENT:
            with suppress(AttributeError, OSError):  # a hanging FMU keeps no core from others
                os.sched_setscheduler(self.worker.pid, os.SCHED_OTHER, os.sched_param(0))  # type: ignore[attr-defined,unused-ignore]
            return State.FAILED, f"the machine has not answered for {silent:.0f} s {self.worker.where}"
        return status.state, str(_details(status).get("unreliable", ""))


def _details(status: MachineStatus) -> dict[str, Any]:
    """Details that the process has published; empty if it died while writing them, or an FMU has."""
    try:
        return dict(json.loads(status.text or "{}"))
    except (ValueError, TypeError, RecursionError):
        return {}


# distance of the frame numbers of two starts, because the old process may go on while the new one starts
APART = 10_000
INTERVAL = 0.1  # [s] between two looks for a failure
POLL = 2e-3  # [s] between two readings of the state while waiting for the start


class RealTimeMachine:
    """A machine that runs in real time.

    Each start or restart has its own process and memory. The frame numbers continue over restarts.
    """

    def __init__(self, setup: Setup, playing: bool = True, speed: float = 1.0) -> None:
        """Returns when the machine is ready; raises Problem for a mistake in the setup."""
        self._playing, self._speed, self._serial = playing, speed_factor(speed), 0
        self._lock = threading.Lock()  # among the threads of this process
        self._ending: list[threading.Thread] = []
        self._process = self._open(setup, 0)
        try:
            frame = self.ready()
            if frame.state == State.FAILED:
                raise Problem(frame.message)
        except BaseException:
            self.close()
            raise

    # ---- description

    @property
    def setup(self) -> Setup:
        """The setup that runs now."""
        return self._process.setup

    @property
    def axes(self) -> tuple[str, ...]:
        return self._process.axes

    @property
    def signals(self) -> tuple[str, ...]:
        return self._process.setup.signals

    @property
    def units(self) -> Mapping[str, str]:
        """Units of axes and signals; empty until the machine is ready."""
        return self._process.units

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the run."""
        return self._process.notes

    @property
    def pid(self) -> int:
        """Identifier of the process that steps the machine."""
        return self._process.worker.pid

    # ---- driving

    def command(self, values: Mapping[str, float]) -> None:
        """Command new values by axis; the others go to rest. The command expires after `timeout`."""
        with self._lock:
            commanded = {axis.name: math.nan for axis in self.setup.axes}
            for name, value in values.items():
                if name not in commanded:
                    raise Problem(f"unknown axis {str(name)[:40]!r}{suggest(str(name)[:40], commanded)}")
                commanded[name] = _number(name, value)
            self._serial += 1
            self._commanded = np.array([*commanded.values()], dtype=np.float64)
            self._send(self._process)

    def play(self) -> None:
        """Continue."""
        self._set(True, self._speed)

    def pause(self) -> None:
        """Stop, and keep the state."""
        self._set(False, self._speed)

    def speed(self, factor: float) -> None:
        """Set the speed relative to real time, 0.1 to 10."""
        self._set(self._playing, speed_factor(factor))

    def restart(self, setup: Setup | None = None) -> None:
        """Start again, optionally with another setup. Returns at once, in the state "starting".

        The machine runs or is paused as before. A setup with a mistake leads to the state "failed".
        """
        with self._lock:
            old = self._process
            if old.closed:
                raise Problem("the machine is closed")
            self._process = self._open(setup or old.setup, old.latest().number + APART)
            ending = threading.Thread(target=old.close, daemon=True)
            ending.start()
            self._ending = [t for t in self._ending if t.is_alive()] + [ending]

    def close(self) -> None:
        """End the process. May be repeated; the frames stay readable."""
        with self._lock:
            self._process.close()
            for ending in self._ending:
                ending.join()

    # ---- watching

    def latest(self) -> Frame:
        """The latest frame; its values are NaN before the first frame of a start."""
        return self._process.latest()

    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Numbers (n,), times (n,), axes (n, axes), values (n, signals) of the frames after a number.

        Only frames of the current start that are still in memory.
        """
        return self._process.since(number)

    def trace(self) -> Trace:
        """Axes and signals over time since the start, as far as they are in memory (see `notes`)."""
        return self._process.trace()

    def ready(self) -> Frame:
        """Wait until the machine has started or failed to start."""
        while (frame := self.latest()).state == State.STARTING:
            time.sleep(POLL)
        return frame

    # ---- inside

    def _open(self, setup: Setup, before: int) -> MachineProcess:
        """Start a process. before: frame number that is shown until its first frame."""
        setup.check()
        # a mapping of another type may be one that cannot be pickled
        setup = replace(setup, swap=dict(setup.swap), set=dict(setup.set), fault=dict(setup.fault))
        process = MachineProcess(setup, before + 1, self._serial)
        self._commanded = np.full(len(setup.axes), np.nan)
        self._send(process)
        return process

    def _set(self, playing: bool, speed: float) -> None:
        with self._lock:
            self._playing, self._speed = playing, speed
            self._send(self._process)

    def _send(self, process: MachineProcess) -> None:
        process.shared.write_command(Command(self._playing, self._speed, self._serial, self._commanded))


def _number(name: str, value: Any) -> float:
    """Convert to a finite number. Raises `Problem`."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = np.nan
    if not np.isfinite(number):
        raise Problem(f"axis {name}: expected a finite number, got {repr(value)[:40]}")
    return number


@contextmanager
def failures_reported(
    machine: RealTimeMachine, save: Callable[[], Path], report: Callable[[str], object]
) -> Iterator[None]:
    """Context that reports each failure in one line; it closes the machine at its end.

    save   saves what the machine has recorded, for each failure; raises Problem if that is nothing
    """
    ended, failed = threading.Event(), False

    def look() -> None:
        nonlocal failed
        frame, before = machine.latest(), failed
        failed = frame.state == State.FAILED
        if failed and not before:
            saved = ""
            with suppress(Problem):
                saved = f"; the session until then is in {save()}"
            report(f"{frame.message}{saved}")

    def watch() -> None:
        while not ended.wait(INTERVAL):
            look()

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        ended.set()
        watching.join()
        machine.close()
        look()  # the FMUs may have failed at the end
