"""The messages an FMU logs during a run, and the status of its calls."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
WARNING, DISCARD, ERROR, FATAL = 1, 2, 3, 4
KEPT = 1000  # messages kept per component; the rest is only counted


@dataclass(frozen=True)
class Message:
    """One log message of an FMU; time [s] is the last communication point."""

    time: float
    component: str
    status: str
    text: str

    def __str__(self) -> str:
        return f"{self.component} at t = {self.time:.6g} s: {self.text}"


@dataclass
class Log:
    """The messages of one component, in order."""

    component: str
    messages: list[Message] = field(default_factory=list)
    dropped: int = 0
    time: float = float("nan")

    def add(self, status: int, text: str) -> None:
        """Keep a message, up to KEPT of them."""
        if len(self.messages) >= KEPT:
            self.dropped += 1
            return
        label = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        self.messages.append(Message(self.time, self.component, label, " ".join(text.split())))

    def last(self, count: int = 3) -> str:
        """The last messages of the latest step, or its errors, as one line to end an error with."""
        recent = self.messages[-count:]
        recent = [m for m in recent if m.time == self.time] or recent
        recent = [m for m in recent if m.status not in ("ok", "warning")] or recent
        texts = list(dict.fromkeys(m.text for m in recent))
        return "".join(f"; it says: {text}" for text in texts)

    def warnings(self) -> list[str]:
        """One line per different message that is not mere information."""
        counted = Counter(m.text for m in self.messages if m.status != "ok")
        first = {m.text: m for m in reversed(self.messages)}
        lines = [f"{first[t]}" + (f" ({n} times)" if n > 1 else "") for t, n in counted.items()]
        return [*lines, f"{self.component}: {self.dropped} more messages"] if self.dropped else lines
