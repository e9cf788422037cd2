"""`Problem`, the exception for a user's mistake, its subclasses, and suggestions of similar names."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any

MAX_COMPARED, MAX_COMPARABLE = 20_000, 200  # names and their characters that are compared, in 1 s
MAX_LISTED = 8  # signals in a message
MAX_LINE = 2000  # characters of a message; values in damaged files can have millions


def one_line(text: str, limit: int = MAX_LINE) -> str:
    """A text for a terminal: control characters are escaped, and the middle of a long text is left out."""
    if len(text) > limit:
        text = f"{text[: limit * 2 // 3]} ... {text[-limit // 3 :]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class Problem(Exception):
    """A user's mistake in one line: `FILE: THING: expected X, got Y`. The user sees no traceback."""

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


class Mistakes(Problem):
    """Several mistakes in one file, a line each."""

    def __init__(self, lines: Sequence[str] | str = ()) -> None:
        self.lines = tuple(lines.splitlines() if isinstance(lines, str) else map(one_line, lines))
        Exception.__init__(self, "\n".join(self.lines))


class Unsupported(Problem):
    """A variable of a type that is not supported, such as an array."""


class NotExchangeable(Problem):
    """An FMU without Model Exchange, or with an incomplete list of states there."""


class Discarded(Problem):
    """An FMU discarded a step after the time `reached` [s]; NaN if the FMU does not report the time.

    A step with status error is treated the same way, because both versions of FMI allow the importer to
    continue from a state that was saved before the step.
    """

    reached = float("nan")


class Ended(Problem):
    """An FMU requests the end of the simulation at the time `reached` [s]."""

    reached = float("nan")


class AtEvent(Exception):
    """An FMU has stopped at an event at the time `reached` [s]."""

    def __init__(self, reached: float) -> None:
        super().__init__()
        self.reached = reached


class LimitReached(Problem):
    """A limit of a run has ended its process; `limit`: time_limit or memory_limit."""

    def __init__(self, message: str, limit: str) -> None:
        super().__init__(message)
        self.limit = limit


class Stopped(Exception):
    """The user ended a command early; the message says which results are kept."""


class UnknownSignal(Problem, KeyError):
    """An unknown signal name; also a KeyError, because traces are used like mappings."""

    __str__ = Exception.__str__  # KeyError would quote the message

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process a plain Problem."""
        return Problem, self.args

    def __init__(
        self, name: object, names: Iterable[str], where: str = "", among: str = "the run", hint: str = ""
    ) -> None:
        """where: file and item; among: what has no such signal; hint: in place of similar names."""
        super().__init__(f"{where}{_unknown(name, list(names), among, hint)}")


def _unknown(name: object, names: Sequence[str], among: str, hint: str) -> str:
    """Why a key selects no signal."""
    if not isinstance(name, str):
        return f"expected the name of a signal{hint}, got {name!r}"
    same = sorted(n for n in names if n.endswith(f".{name}"))
    if len(same) > 1:
        more = ", ..." if len(same) > MAX_LISTED else ""
        return f"{name} is in {len(same)} components: {', '.join(same[:MAX_LISTED])}{more}"
    hint = hint or suggest(name, names) or f"; there are {', '.join(sorted(names)[:MAX_LISTED]) or 'none'}"
    return f"no signal {name} in {among}{hint}"


def suggest(name: str, names: Iterable[str]) -> str:
    """'; did you mean a, b?' for the end of a message; variables of the same name come first."""
    import difflib  # on first use, because a child process of `check` must start fast

    names = [n for n in islice(names, MAX_COMPARED) if len(n) <= MAX_COMPARABLE]
    if len(name) > MAX_COMPARABLE:
        return ""
    same_variable = [n for n in names if n.rpartition(".")[2] == name.rpartition(".")[2]]
    texts: dict[str, list[str]] = {}  # a name without component is compared with such names, too
    for n in names:
        for text in {n, n if "." in name else n.rpartition(".")[2]}:
            texts.setdefault(text, []).append(n)
    close = [n for text in difflib.get_close_matches(name, texts, n=3, cutoff=0.5) for n in texts[text]]
    similar = dict.fromkeys([*same_variable, *close])
    return f"; did you mean {', '.join(list(similar)[:3])}?" if similar else ""
