"""The FMU on which a probe works in a child process, and the function that runs one task there."""

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, TypedDict, Unpack

from orchestrator.base.errors import Problem
from orchestrator.base.processes import remove_folder
from orchestrator.fmi.description import Entry, ModelDescription
from orchestrator.fmi.instance import CallFailed, Crashed, FmuInstance, resources_location
from orchestrator.fmi.library import Library, find_library
from orchestrator.fmi.messages import ERROR, Log
from orchestrator.worker.calls import Activity
from orchestrator.worker.main import Channel

MAX_MESSAGES = 10_000  # log messages that are kept per instance
FORKS = hasattr(os, "fork") and sys.platform != "darwin"  # there, libraries of the system may crash in a fork
FINISHED = 93  # exit status of a fork whose task is complete
Remark = tuple[str, str]  # severity, text
Task = Callable[["Trial"], Iterator[Remark]]


class InstanceOptions(TypedDict, total=False):
    """Arguments of `FmuInstance.instantiate` by which an instance may differ from the usual one."""

    token: str
    resources: str | None
    name: str
    verbose: bool
    update: Any
    early: bool
    required: Sequence[int]


class OnlyOnce(Exception):
    """The FMU can be instantiated only once per process, and this process has done so already."""


@dataclass
class Trial:
    """One FMU with one of its interfaces, on which one task works.

    kind         CoSimulation or ModelExchange
    seconds      wall time that the task may fill with simulation
    perturbable  the FMU accepts small changes of its inputs
    summed       the FMU accepts communication points only if they are the sum of the steps before
    payload      data from an earlier task
    result       data for a later task
    first_case   number of the first case to run: a child process that crashed has done those before it
    begin_case   reports to the parent process which case begins
    """

    folder: Path
    description: ModelDescription
    kind: str
    activity: Activity
    seconds: float = 1.0
    perturbable: bool = False
    summed: bool = False
    payload: Any = None
    result: Any = None
    first_case: int = 0
    begin_case: Callable[[int], None] = lambda _: None
    _instances: int = 0

    @property
    def interface(self) -> Entry:
        """The element of modelDescription.xml with the capabilities of this interface."""
        return self.description.interfaces[self.kind]

    @cached_property
    def library(self) -> Library:
        """The library, loaded on first use."""
        return self.load(self.folder)

    def load(self, folder: Path, identifier: str = "") -> Library:
        """The library of an unpacked FMU; raises OSError if it cannot be loaded."""
        identifier = identifier or self.interface.get("modelIdentifier")
        path = find_library(folder, identifier, self.description.major)
        if path is None:
            raise FileNotFoundError("no binary for this platform")
        self.activity.call(f"loading {path.name}")
        return Library(path, self.description.major)

    def instance(
        self, kind: str = "", library: Library | None = None, **options: Unpack[InstanceOptions]
    ) -> FmuInstance:
        """A new instance; raises OnlyOnce if a second one is not allowed, CallFailed if the FMU fails.

        options   how it differs from the usual one
        """
        kind, library = kind or self.kind, library or self.library
        if self._instances and self.description.interfaces[kind].declares(
            "canBeInstantiatedOnlyOncePerProcess"
        ):
            raise OnlyOnce
        log = Log(names={v.mark: v.name for v in self.description.variables}, limit=MAX_MESSAGES)
        instance = FmuInstance(library, log, kind == "ModelExchange", self.activity.call)
        resources = resources_location(self.folder, self.description.major)
        usual: InstanceOptions = {"token": self.description.token, "resources": resources, "name": "probe"}
        given: InstanceOptions = {**usual, **options}
        able = kind == "CoSimulation" and self.description.interfaces[kind].declares("hasEventMode")
        used = able and any(v.kind == "Clock" for v in self.description.variables)  # as in a run
        if not any(instance.instantiate(**given, events=events) for events in dict.fromkeys((used, able))):
            call = instance.describe_call("Instantiate")
            raise CallFailed(f"{call} returns no instance{log.quoted_messages()}", ERROR)
        self._instances += 1
        return instance


def main(channel: Channel) -> None:
    """Run the tasks that the parent process sends, each in a fork of this process, which has the imports.

    If a fork does not end by itself, this process ends in the same way. Without forks it runs one task.
    """
    for module in Path(__file__).parent.glob("[a-z]*.py"):
        import_module(f"orchestrator.check.tasks.{module.stem}")
    warnings.simplefilter(
        "ignore"
    )  # NumPy warns about values that are not finite, which are no mistakes here
    own = {*channel.folder.iterdir()}
    while job := channel.get():
        channel.activity.clear()
        if not FORKS or not (pid := channel.fork()):
            break
        end = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if end != FINISHED:
            os.kill(os.getpid(), max(-end, 0))
            os._exit(end)
        for left in {*channel.folder.iterdir()} - own:
            remove_folder(left) if left.is_dir() else left.unlink(missing_ok=True)
        channel.put("idle")
    channel.put("pid", os.getpid())
    trial = Trial(**job["trial"], activity=channel.activity, begin_case=lambda n: channel.put("case", n))
    module, _, name = job["task"].partition(":")
    task: Task = getattr(import_module(f"orchestrator.check.tasks.{module}"), name)
    try:
        for severity, text in task(trial):
            channel.put("remark", (severity, text))
    except OnlyOnce:
        pass  # the rest of the task needs another instance
    except Problem as problem:
        grave, why = ("error", "")
        if module == "leaks":  # an instance that is refused, such as by a licence, is no leak
            grave, why = ("note", "not measured: ")
        elif not trial._instances and trial.interface.declares("needsExecutionTool"):
            grave, why = ("warning", "the tool that the FMU needs may be missing: ")
        channel.put("remark", (grave, f"{why}{problem}"))
    except Crashed as problem:
        channel.put("crash", str(problem))
    except OSError as problem:
        path, _, reason = str(problem).partition(": ")  # the message omits the path of the temporary folder
        message = reason if reason and "/" in path else problem
        channel.put("remark", ("error", f"the binary cannot be loaded: {message}"))
    except Exception as problem:  # a defect of the check, not of the FMU: the other probes continue
        text = f"the probe failed (a defect of this check): {problem!r}"
        channel.put("remark", ("warning", text))
    channel.put("done", trial.result)
    os._exit(FINISHED)
