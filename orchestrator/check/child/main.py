"""What a probe has at hand in the child process, and how one is run there; `probes.parent` starts it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from orchestrator.check.child.binary import Binary, Crashed, Missing, Refused, find
from orchestrator.check.child.description import Declared, read
from orchestrator.check.child.instance import Spent
from orchestrator.check.child.player import Player, difference, movable, scalars, watched
from orchestrator.worker.beacon import Beacon
from orchestrator.worker.main import Channel

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


def main(channel: Channel) -> None:
    """Do the job that the parent sends, and tell each finding at once."""
    job = channel.get()
    folder = Path(job["folder"])
    bench = Bench(
        folder=folder,
        declared=read(folder),
        side=job["side"],
        beacon=channel.beacon,
        seconds=job["seconds"],
        **job["habits"],
        payload=job["payload"],
        first=job["first"],
        at=lambda stage: channel.put({"stage": stage}),
    )
    module, _, name = job["task"].partition(":")
    task: Task = getattr(import_module(f"orchestrator.check.child.tasks.{module}"), name)
    try:
        for severity, text in task(bench):
            channel.put({"severity": severity, "text": text})
    except Spent:
        pass  # the rest of the task needs another instance
    except (Refused, Missing) as problem:
        channel.put({"severity": "error", "text": str(problem)})
    except Crashed as problem:
        channel.put({"crash": str(problem)})
    except OSError as problem:
        channel.put({"severity": "error", "text": f"the binary cannot be loaded: {_first(problem)}"})
    except Exception as problem:  # ours, not the FMU's: said as such, and the other probes go on
        text = f"could not be tried (a defect of this check): {problem!r}"
        channel.put({"severity": "warning", "text": text})
    channel.put({"done": True, "result": bench.result})


def _first(problem: OSError) -> str:
    """The message without the path of the temporary folder."""
    words = str(problem).split(": ", 1)
    return words[-1] if len(words) > 1 and "/" in words[0] else str(problem)
