"""The pages that are open, and what everybody may know about who drives."""

from __future__ import annotations

import itertools
import secrets
from collections import Counter
from dataclasses import dataclass, field

from orchestrator.view.safety.limit import Bucket

MOST = 50  # pages at once; beyond that the oldest without a connection goes


@dataclass(eq=False)
class Seat:
    """A page in a browser; the key is known to that page only.

    number     of the last message that counted in this connection
    heard      when it came [s]
    held       that message said that the dead-man is held
    armed      the dead-man was seen released since the driver took over or since the last fault
    connection counts its connections; what an older one says no longer counts
    counts     of messages: "accepted", "refused", "old", "flood"
    why        what was wrong with the last refused one
    """

    name: str
    opened: float
    key: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    number: int = -1
    heard: float = float("-inf")
    held: bool = False
    armed: bool = False
    connection: int = 0
    connected: bool = False
    bucket: Bucket = field(default_factory=Bucket)
    counts: Counter[str] = field(default_factory=Counter)
    why: str = ""


@dataclass(frozen=True)
class Status:
    """What a page shows about the controls.

    role      "driving", "watching" (somebody else drives) or "free" (nobody does)
    driver    name of who drives, or empty
    asked     name of who asks for the controls, or empty
    live      the machine follows the sticks now: the dead-man's lamp
    why       why it does not, in a few words, and what to do
    drives    the machine can be driven
    pattern, mode, modes
    counts    of messages of this page
    """

    role: str
    driver: str
    asked: str
    live: bool
    why: str
    drives: bool
    pattern: str
    mode: str
    modes: tuple[str, ...]
    counts: dict[str, int]


class Seats:
    """All open pages."""

    def __init__(self) -> None:
        self._all: list[Seat] = []
        self._names = itertools.count(1)

    def __contains__(self, seat: Seat) -> bool:
        return seat in self._all

    def add(self, now: float) -> Seat:
        """A new one, the latest; one that was opened and never connected may have to go for it."""
        spare = [seat for seat in self._all if not seat.connected]
        for seat in spare[: max(0, len(self._all) - MOST + 1)]:
            self._all.remove(seat)
        self._all.append(Seat(f"page {next(self._names)}", now))
        return self._all[-1]

    def remove(self, seat: Seat) -> None:
        """The page is gone; a second time nothing happens."""
        if seat in self._all:
            self._all.remove(seat)

    def find(self, key: str) -> Seat | None:
        """The seat of this key, compared without telling by the time taken how much of it was right."""
        given = key.encode()
        return next((seat for seat in self._all if secrets.compare_digest(seat.key.encode(), given)), None)
