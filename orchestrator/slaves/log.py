"""The messages an FMU logs during a run, and the status of its calls."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orchestrator.files.trace import Trace

STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
WARNING, DISCARD, ERROR, FATAL = 1, 2, 3, 4
KEPT = 1000  # messages kept per component; the rest is only counted
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_NAME = re.compile(r"([\w.\[\]]+) = ")  # a message that begins with a variable and its value
_TIME = re.compile(rf"\bt = {_NUMBER.pattern}")


@dataclass(frozen=True)
class Message:
    """One log message of an FMU; time [s] is the last communication point, step the beginning of the step."""

    time: float
    component: str
    status: str
    text: str
    step: float = field(default=np.nan, compare=False)

    def __str__(self) -> str:
        when = "" if _TIME.search(self.text) else f" at t = {self.time:.6g} s"  # an FMU may tell a better one
        return f"{self.component}{when}: {self.text}"


@dataclass
class Log:
    """The messages of one component, in order.

    clock   shape (2,) [s]: the last communication point, and where the last step began
    """

    component: str
    messages: list[Message] = field(default_factory=list)
    dropped: int = 0
    clock: NDArray[np.float64] = field(default_factory=lambda: np.full(2, np.nan))

    @property
    def time(self) -> float:
        """The last communication point [s]."""
        return float(self.clock[0])

    @time.setter
    def time(self, t: float) -> None:
        self.clock[0] = t

    def begin_step(self, t: float) -> None:
        """A step begins at t [s]."""
        self.clock[:] = t

    def add(self, status: int, text: str) -> None:
        """Keep a message, up to KEPT of them."""
        if len(self.messages) >= KEPT:
            self.dropped += 1
            return
        text = re.sub(r"^\s*fmi[23]\w+: ", "", text)  # the function that was called is of no use to a reader
        label = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        self.messages.append(Message(self.time, self.component, label, " ".join(text.split()), self.clock[1]))

    def withdraw(self) -> None:
        """Forget the messages of steps from the last communication point on, which are to be repeated."""
        self.messages = [m for m in self.messages if not m.step >= self.time]

    def last(self, count: int = 3) -> str:
        """The last messages of the latest step, or its errors, as one line to end an error with."""
        recent = self.messages[-count:]
        recent = [m for m in recent if m.time == self.time] or recent
        recent = [m for m in recent if m.status not in ("ok", "warning")] or recent
        texts = list(dict.fromkeys(m.text for m in recent))
        return "".join(f"; it says: {text}" for text in texts)

    def warnings(self, trace: Trace | None = None) -> list[str]:
        """One line per message that is not mere information; those that differ in numbers only are merged.

        trace   the record: a message tells a value when it was noticed, the record may have larger ones
        """
        alike: dict[str, list[Message]] = {}
        for m in self.messages:
            if m.status != "ok":
                alike.setdefault(_NUMBER.sub("#", m.text), []).append(m)
        lines = [_merged(group, trace) for group in alike.values()]
        return [*lines, f"{self.component}: {self.dropped} more messages"] if self.dropped else lines


def _merged(alike: list[Message], trace: Trace | None) -> str:
    """Messages that differ in numbers only, as the first of them."""
    first, largest = alike[0], _largest(alike[0], trace)
    if len(alike) == 1:
        return f"{first}{f' ({largest})' if largest else ''}"
    varying = len({_TIME.sub("", m.text) for m in alike}) > 1
    at = f"t = {first.time:.6g} s"
    count = f"the first of {len(alike)}, at {at}" if varying else f"{len(alike)} times, first at {at}"
    return f"{first.component}: {first.text} ({'; '.join(filter(None, (count, largest)))})"


def _largest(message: Message, trace: Trace | None) -> str:
    """The largest magnitude in the record of the variable that a message is about."""
    match = _NAME.match(message.text)
    name = f"{message.component}.{match[1]}" if match else ""
    if trace is None or name not in trace.signals or not len(trace.time):
        return ""
    row = int(np.argmax(np.abs(trace[name])))
    value = f"{trace[name][row]:.6g} {trace.units.get(name, '')}".rstrip()
    return f"largest recorded: {value} at t = {trace.time[row]:.6g} s"
