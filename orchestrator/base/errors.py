"""The one exception for a user's mistake, told in one line, and the names that may have been meant."""

from __future__ import annotations

from collections.abc import Iterable


class Problem(Exception):
    """Names the file, the thing, what was expected and what was found. No traceback is shown."""


class Unsupported(Problem):
    """A variable of a kind that cannot be used here, such as an array."""


class Discarded(Problem):
    """An FMU did only part of a step: up to `reached` [s], NaN if it does not say.

    An error in a step counts as one: both versions of FMI allow to go on from a state saved before.
    """

    reached = float("nan")


class Ended(Problem):
    """An FMU asks to end the simulation at `reached` [s]."""

    reached = float("nan")


class Stopped(Exception):
    """The user ended a command early; tells what is kept of its work."""


class UnknownSignal(Problem, KeyError):
    """A name that no signal has; a KeyError too, because traces are looked up like mappings."""

    __str__ = Exception.__str__  # KeyError would put the text in quotes

    def __init__(self, name: str, known: Iterable[str], where: str = "") -> None:
        names = list(known)
        near = suggest(name, names) or f"; there are {', '.join(sorted(names)[:8]) or 'none'}"
        super().__init__(f"{where}no signal {name} in the run{near}")


def suggest(name: str, known: Iterable[str]) -> str:
    """'; did you mean a, b?', for the end of a message; first what differs only by its component."""
    import difflib  # late: a child process of `check` starts without

    names = list(known)
    tail = [n for n in names if n.rpartition(".")[2] == name.rpartition(".")[2]]
    close = dict.fromkeys([*tail, *difflib.get_close_matches(name, names, n=3, cutoff=0.5)])
    return f"; did you mean {', '.join(list(close)[:3])}?" if close else ""
