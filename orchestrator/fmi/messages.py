"""What an FMU logs, and how much of it a user reads: the messages of one instance, in order."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orchestrator.data.trace import Trace

STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
WARNING, DISCARD, ERROR, FATAL = 1, 2, 3, 4
MAX_QUOTED = 300  # characters of a message that are quoted at the end of an error
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_NAME = re.compile(r"([\w.\[\]]+) = ")  # a message that begins with a variable and its value
_TIME = re.compile(rf"\bt = {_NUMBER.pattern}")


def status_label(status: int) -> str:
    """What a status is called."""
    return STATUS[status] if 0 <= status < len(STATUS) else str(status)


@dataclass(frozen=True)
class LogMessage:
    """One log message of an FMU; time [s] is the last communication point, step the beginning of the step."""

    time: float
    component: str
    status: str
    text: str
    step: float = field(default=math.nan, compare=False)
    category: str | None = field(default=None, compare=False)

    def __str__(self) -> str:
        when = "" if _TIME.search(self.text) else f" at t = {self.time:.6g} s"  # an FMU may tell a better one
        return f"{self.component}{when}: {self.text}"


@dataclass
class Log:
    """The messages of one component, in order.

    names   value reference -> name, for messages of FMI 3.0
    kept    messages that are kept; the rest is only counted
    clock   [s]: the last communication point, and where the last step began; C writes there, too
    """

    component: str = ""
    names: Mapping[int, str] = field(default_factory=dict)
    limit: int = 1000
    messages: list[LogMessage] = field(default_factory=list)
    dropped: int = 0
    clock: ctypes.Array[ctypes.c_double] = field(
        default_factory=lambda: (ctypes.c_double * 2)(math.nan, math.nan)
    )

    @property
    def time(self) -> float:
        """The last communication point [s]."""
        return self.clock[0]

    @time.setter
    def time(self, t: float) -> None:
        self.clock[0] = t

    def begin_step(self, t: float) -> None:
        """A step begins at t [s]."""
        self.clock[0] = self.clock[1] = t

    def add(self, status: int, text: str, category: str | None = None) -> None:
        """Keep a message; in FMI 3.0 #12# stands for the variable 12 and ## for #."""
        if len(self.messages) >= self.limit:
            self.dropped += 1
            return
        text = re.sub(r"^\s*fmi[23]\w+: ", "", text)  # the function that was called is of no use to a reader
        text = " ".join(with_variable_names(text, self.names).split() if self.names else text.split())
        self.messages.append(
            LogMessage(self.time, self.component, status_label(status), text, self.clock[1], category)
        )

    def discard_repeated(self) -> None:
        """Forget the messages of steps from the last communication point on, which are to be repeated."""
        self.messages = [m for m in self.messages if not m.step >= self.time]

    def error_message(self, what: str, more: str) -> str:
        """An error message: what happened in which component, when, and the FMU's own reason for it."""
        name = f"{self.component}: " if self.component else ""
        when = f" at t = {self.time:.9g} s" if self.time == self.time else ""
        return f"{name}{what}{when} {more}{self.quoted_messages()}"

    def quoted_messages(self, count: int = 3) -> str:
        """The last messages of the latest step, or its errors, as one line to end an error with."""
        recent = self.messages[-count:]
        recent = [m for m in recent if m.time == self.time] or recent
        recent = [m for m in recent if m.status not in ("ok", "warning")] or recent
        texts = list(dict.fromkeys(m.text[:MAX_QUOTED] for m in recent))
        return "".join(f"; it says: {text}" for text in texts)

    def warnings(self, trace: Trace | None = None) -> list[str]:
        """One line per message that is not mere information; those that differ in numbers only are merged.

        trace   the record: a message has the value when it was noticed, the record may have larger ones
        """
        alike: dict[str, list[LogMessage]] = {}
        for m in self.messages:
            if m.status != "ok":
                alike.setdefault(_NUMBER.sub("#", m.text), []).append(m)
        lines = [_merged(group, trace) for group in alike.values()]
        return [*lines, f"{self.component}: {self.dropped} more messages"] if self.dropped else lines


def with_variable_names(text: str, names: Mapping[int, str]) -> str:
    """A message of FMI 3.0 with names in place of value references: #12# is the variable 12, ## is #."""

    def name(found: re.Match[str]) -> str:
        number = found.group(1)
        return names.get(int(number), found.group()) if number else "#"

    return re.sub(r"#(\d*)#", name, text)


def _merged(alike: list[LogMessage], trace: Trace | None) -> str:
    """Messages that differ in numbers only, as the first of them."""
    first, largest = alike[0], _largest(alike[0], trace)
    if len(alike) == 1:
        return f"{first}{f' ({largest})' if largest else ''}"
    varying = len({_TIME.sub("", m.text) for m in alike}) > 1
    at = f"t = {first.time:.6g} s"
    count = f"the first of {len(alike)}, at {at}" if varying else f"{len(alike)} times, first at {at}"
    return f"{first.component}: {first.text} ({'; '.join(filter(None, (count, largest)))})"


def _largest(message: LogMessage, trace: Trace | None) -> str:
    """The largest magnitude in the record of the variable that a message is about."""
    match = _NAME.match(message.text)
    name = f"{message.component}.{match[1]}" if match else ""
    if trace is None or name not in trace.signals or not len(trace.time):
        return ""
    row = int(abs(trace[name]).argmax())
    value = f"{trace[name][row]:.6g} {trace.units.get(name, '')}".rstrip()
    return f"largest recorded: {value} at t = {trace.time[row]:.6g} s"
