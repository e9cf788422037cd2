"""What a probe has at hand in the child process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.trial.beacon import Beacon
from orchestrator.trial.binary import Binary, find
from orchestrator.trial.declared import Declared
from orchestrator.trial.player import Player, difference, movable, watched
from orchestrator.trial.values import scalars

SHOWN = 5  # inputs in a message
Said = tuple[str, str]  # severity, text
Task = Callable[["Bench"], Iterator[Said]]


@dataclass
class Bench:
    """One probe of one side of one FMU.

    seconds   wall time that the probe may fill with work
    pokes     the FMU takes small changes of its inputs
    summed    it takes communication points that are summed only, not those that are counted
    payload   what an earlier child handed over
    result    what this child hands over
    first     number of the stage to begin with: those before it were done by a child that crashed
    at        tells the parent which stage begins
    """

    folder: Path
    declared: Declared
    side: str
    beacon: Beacon
    seconds: float = 1.0
    pokes: bool = False
    summed: bool = False
    payload: Any = None
    result: Any = None
    first: int = 0
    at: Callable[[int], None] = lambda _: None
    _binary: list[Binary] = field(default_factory=list)

    @property
    def binary(self) -> Binary:
        """The library, loaded on first use."""
        if not self._binary:
            self._binary.append(self.load(self.folder))
        return self._binary[0]

    def load(self, folder: Path) -> Binary:
        """The library of an unpacked FMU."""
        path = find(folder, self.declared, self.side)
        if path is None:
            raise FileNotFoundError("no binary for this platform")
        return Binary(path, self.declared, self.beacon)

    def can(self, *names: str) -> bool:
        """Is one of these capabilities declared?"""
        return self.declared.can(self.side, *names)

    def player(self, **options: Any) -> Player:
        """A new instance."""
        usual = {"start": self.declared.experiment.get("startTime", 0.0), "summed": self.summed}
        options = usual | options
        binary, side = options.pop("binary", None) or self.binary, options.pop("side", self.side)
        return Player(binary, side, self.folder, **options)

    def names(self) -> list[str]:
        """Names of the scalars in a row."""
        return scalars(watched(self.declared))

    def difference(self, first: Sequence[Sequence[float]], second: Sequence[Sequence[float]]) -> str:
        """In words: where two runs differ first, and which inputs were moved; empty when they do not."""
        text = difference(self.names(), first, second)
        moved = scalars(movable(self.declared)) if self.pokes else []
        if not text or not moved:
            return text
        more = f" and {len(moved) - SHOWN} more" if len(moved) > SHOWN else ""
        return f"{text}, while {', '.join(moved[:SHOWN])}{more} moved"
