"""Log messages of an FMU instance, and their presentation in errors and warnings."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from orchestrator.base.errors import one_line
from orchestrator.base.text import sized

if TYPE_CHECKING:
    from orchestrator.data.trace_writer import TraceSink

STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
WARNING, DISCARD, ERROR, FATAL = 1, 2, 3, 4
LOCAL = {"local": True}  # of a field that is not sent to another process, see `worker.wire`
MAX_QUOTED = 300  # characters of a log message at the end of an error message
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_NAME = re.compile(r"(?:^|: )([\w.\[\]]+) = ")  # a variable and its value
# after the value in a warning of an FMU of this project, and at the end of its last one of a variable
_LIMIT, _LAST = re.compile(r" \((lower )?limit [^)]*\)"), "; no further warning of it follows"
_TIME = re.compile(rf"\bt = {_NUMBER.pattern}")


def status_label(status: int) -> str:
    """The name of a status."""
    return STATUS[status] if 0 <= status < len(STATUS) else str(status)


@dataclass(frozen=True)
class LogMessage:
    """A log message of an FMU.

    time   last communication point [s]
    step   start time of the step [s]; NaN outside of steps
    """

    time: float
    component: str
    status: str
    text: str
    step: float = field(default=math.nan, compare=False)
    category: str | None = field(default=None, compare=False)

    def __str__(self) -> str:
        known = _TIME.search(self.text) or self.time != self.time
        when = "" if known else f" at t = {self.time:.6g} s"
        return f"{self.component}{when}: {self.text}"


@dataclass
class Log:
    """The log messages of one component, in order.

    names     `FmuVariable.mark` -> name
    limit     largest number of stored messages; further messages are only counted
    dropped   number of messages that were not stored
    on_message   called with each message that is stored
    clock     last communication point, start and end of the last step [s]; also written by the loop in C
    """

    component: str = ""
    names: Mapping[str, str] = field(default_factory=dict, metadata=LOCAL)
    limit: int = 1000
    messages: list[LogMessage] = field(default_factory=list)
    dropped: int = 0
    on_message: Callable[[LogMessage], None] | None = field(default=None, metadata=LOCAL)
    clock: ctypes.Array[ctypes.c_double] = field(
        default_factory=lambda: (ctypes.c_double * 3)(*[math.nan] * 3), metadata=LOCAL
    )

    def __getstate__(self) -> dict[str, Any]:
        """The messages until now, for a copy."""
        return self.__dict__ | {"messages": [*self.messages], "on_message": None, "clock": [*self.clock]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, clock=(ctypes.c_double * 3)(*state["clock"]))

    @property
    def time(self) -> float:
        """The last communication point [s]."""
        return self.clock[0]

    @time.setter
    def time(self, t: float) -> None:
        self.clock[0] = t

    def begin_step(self, t: float, h: float) -> None:
        """Set the time for messages to the start of a step from t to t + h [s]."""
        self.clock[:] = [t, t, t + h]

    def add(self, status: int, text: str, category: str | None = None) -> None:
        """Store a message, with the names of variables."""
        if len(self.messages) >= self.limit:
            self.dropped += 1
            return
        text = re.sub(r"^\s*fmi[23]\w+: ", "", text)  # without the name of the function
        text = one_line(" ".join(with_variable_names(text, self.names).split()))
        message = LogMessage(self.time, self.component, status_label(status), text, self.clock[1], category)
        self.messages.append(message)
        if self.on_message:
            self.on_message(message)

    def discard_repeated(self) -> None:
        """Discard the messages of steps after the last communication point, which will be repeated."""
        self.messages = [m for m in self.messages if not m.step >= self.time]

    def error_message(self, event: str, details: str) -> str:
        """An error message: component, event, time, details, and the last messages of the FMU."""
        name = f"{self.component}: " if self.component else ""
        when = f" at t = {self.time:.9g} s" if self.time == self.time else ""
        return f"{name}{event}{when} {details}{self.quoted_messages()}"

    def quoted_messages(self, count: int = 3) -> str:
        """The last messages of the last step, or only its errors, for the end of an error message."""
        recent = self.messages[-count:]
        recent = [m for m in recent if m.time == self.time] or recent
        recent = [m for m in recent if m.status not in ("ok", "warning")] or recent
        texts = list(dict.fromkeys(m.text[:MAX_QUOTED] for m in recent))
        return "".join(f"; it says: {text}" for text in texts)

    def warnings(self, recorded: TraceSink | None = None) -> list[str]:
        """Warnings and errors, one line each; messages that differ only in numbers are merged.

        recorded   signals: their largest magnitude is added, which can exceed the value in the message
        """
        groups: dict[str, list[LogMessage]] = {}
        for m in self.messages:
            if m.status != "ok":
                groups.setdefault(_NUMBER.sub("#", m.text.removesuffix(_LAST)), []).append(m)
        lines = [_merged(group, recorded) for group in groups.values()]
        return [*lines, f"{self.component}: {self.dropped} more messages"] if self.dropped else lines


def with_variable_names(text: str, names: Mapping[str, str]) -> str:
    """Replace marks in a message by names: #12# or, in FMI 2.0, #r12# is a variable, ## is #."""
    return re.sub(r"#([ribs]?\d+)?#", lambda found: names.get(found[1], found[0]) if found[1] else "#", text)


def _merged(group: list[LogMessage], recorded: TraceSink | None) -> str:
    """One line for messages that differ only in numbers, with the text of the first one."""
    first, added, count = group[0], [_largest(group[0], recorded)], len(group)
    varying = len({_TIME.sub("", m.text) for m in group}) > 1
    text = str(first) if varying or count == 1 else f"{first.component}: {first.text}"
    if varying:
        added.append(f"the first of {count}{' or more' * group[-1].text.endswith(_LAST)}")
    elif count > 1:
        added.append(f"{count} times, first at t = {first.time:.6g} s")
    more = [*filter(None, added)]
    if more and (limit := _LIMIT.search(text)):
        return f"{text[: limit.end()]}, {', '.join(more)}{text[limit.end() :]}"
    return f"{text} ({'; '.join(more)})" if more else text


def _largest(message: LogMessage, recorded: TraceSink | None) -> str:
    """The largest recorded magnitude of the variable in a message; empty if it was not recorded."""
    match = _NAME.search(message.text)
    name = f"{message.component}.{match[1]}" if match else ""
    largest = recorded.largest(name) if recorded is not None else None
    is_low = re.search(r" is below | \(lower limit ", message.text)
    if recorded is None or largest is None or (is_low and largest[0] > 0):
        return ""  # the largest magnitude is not the lowest value
    size = sized(largest[0] if is_low else abs(largest[0]), recorded.layout.units.get(name, ""))
    return f"{'down to' if is_low else 'at most'} {size} at t = {largest[1]:.6g} s"
