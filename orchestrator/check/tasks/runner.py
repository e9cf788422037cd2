"""The FMU that a task tries out in the child process, and how a task is run there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.fmi.instance import CallFailed, Crashed, FmuInstance, resources_location
from orchestrator.fmi.library import Library, find_library
from orchestrator.fmi.messages import ERROR, Log
from orchestrator.fmi.raw_description import Entry, ModelDescription
from orchestrator.worker.activity import ActivityRecord
from orchestrator.worker.main import Channel

MESSAGES = 10_000  # of an instance that are kept
Remark = tuple[str, str]  # severity, text
Task = Callable[["Trial"], Iterator[Remark]]


class OnlyOnce(Exception):
    """This process has had its one instance of an FMU that declares that it can be made only once."""


@dataclass
class Trial:
    """One FMU in one of its interfaces, under trial by one task.

    kind      CoSimulation or ModelExchange
    seconds   wall time that the task may fill with work
    pokes     the FMU takes small changes of its inputs
    summed    it takes communication points that are summed only, not those that are counted
    payload   what an earlier task handed over
    result    what this task hands over
    first     number of the stage to begin with: those before it were done by a child that crashed
    at        tells the parent which stage begins
    """

    folder: Path
    description: ModelDescription
    kind: str
    beacon: ActivityRecord
    seconds: float = 1.0
    pokes: bool = False
    summed: bool = False
    payload: Any = None
    result: Any = None
    first: int = 0
    at: Callable[[int], None] = lambda _: None
    _library: list[Library] = field(default_factory=list)
    _made: int = 0

    @property
    def able(self) -> Entry:
        """What the FMU declares of this interface."""
        return self.description.interfaces[self.kind]

    @property
    def library(self) -> Library:
        """The library, loaded on first use."""
        if not self._library:
            self._library.append(self.load(self.folder))
        return self._library[0]

    def load(self, folder: Path, identifier: str = "") -> Library:
        """The library of an unpacked FMU; raises OSError where it cannot be loaded."""
        path = find_library(folder, identifier or self.able.get("modelIdentifier"), self.description.major)
        if path is None:
            raise FileNotFoundError("no binary for this platform")
        self.beacon.call(f"loading {path.name}")
        return Library(path, self.description.major)

    def instance(self, kind: str = "", library: Library | None = None, **options: Any) -> FmuInstance:
        """A new instance; raises OnlyOnce where none is left, CallFailed where the FMU gives none."""
        kind, library = kind or self.kind, library or self.library
        if self._made and self.description.interfaces[kind].declares("canBeInstantiatedOnlyOncePerProcess"):
            raise OnlyOnce
        log = Log(limit=MESSAGES)
        instance = FmuInstance(library, log, kind == "ModelExchange", self.beacon.call)
        usual = {"token": self.description.token, "name": "probe"}
        place = {"resources": resources_location(self.folder, self.description.major)}
        if not instance.instantiate(**{**usual, **place, **options}):
            raise CallFailed(
                f"{instance.describe_call('Instantiate')} gives no instance{log.quoted_messages()}", ERROR
            )
        self._made += 1
        return instance


def main(channel: Channel) -> None:
    """Do the job that the parent sends, and send each finding at once."""
    job = channel.get()
    trial = Trial(**job["trial"], beacon=channel.activity, at=lambda stage: channel.put({"stage": stage}))
    module, _, name = job["task"].partition(":")
    task: Task = getattr(import_module(f"orchestrator.check.tasks.{module}"), name)
    try:
        for severity, text in task(trial):
            channel.put({"severity": severity, "text": text})
    except OnlyOnce:
        pass  # the rest of the task needs another instance
    except Problem as problem:
        channel.put({"severity": "error", "text": str(problem)})
    except Crashed as problem:
        channel.put({"crash": str(problem)})
    except OSError as problem:
        place, _, why = str(problem).partition(": ")  # without the path of the temporary folder
        reason = why if why and "/" in place else problem
        channel.put({"severity": "error", "text": f"the binary cannot be loaded: {reason}"})
    except Exception as problem:  # ours, not the FMU's: said as such, and the other probes go on
        text = f"could not be tried (a defect of this check): {problem!r}"
        channel.put({"severity": "warning", "text": text})
    channel.put({"done": True, "result": trial.result})
