"""Slaves for PythonFMU: what their methods do is in `instance`.

The script of an FMU defines one class from `SubsystemSlave` or `UserSlave` (`scripts`). Our own library calls
it through `door`; PythonFMU's library can call it, too, within what that one offers.
"""

from __future__ import annotations

import json
import sys
from abc import abstractmethod
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmus.export.interface import interface
from fmus.export.model_description import LOG_CATEGORIES
from fmus.export.python.behaviour import Behaviour, Continuous, Functions
from fmus.export.python.instance import Instance, told
from fmus.export.python.user_file import fingerprint, load, subsystem
from fmus.export.python.user_model import Stepwise, face
from fmus.parameters import Values
from orchestrator.base.errors import Problem
from orchestrator.ssp.common import package_version

CARD = "model.json"  # in resources/: what the FMU was built from


class Slave(Fmi2Slave):  # type: ignore[misc]
    """One instance; methods raise, but `do_step` logs what went wrong and returns False."""

    log_categories: ClassVar[dict[str, str]] = LOG_CATEGORIES

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.folder = Path(self.resources)
        self.card = json.loads((self.folder / CARD).read_text(encoding="utf-8"))
        self.guid = self.card["guid"]
        self._check_version()
        self.instance = Instance(self.behaviour(), self.guid, self._warn)

    @abstractmethod
    def behaviour(self) -> Behaviour:
        """The model."""

    def _check_version(self) -> None:
        name, built, here = self.card["name"], self.card["version"], package_version()
        if built != here:
            raise Problem(
                f"{name}: built with harvester-cosim {built}, the one in {sys.prefix} is {here}: "
                f"install {built}, or build the FMU again"
            )

    def _warn(self, text: str) -> None:
        self.log(text, Fmi2Status.warning)

    # ---- PythonFMU's names

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """See `Instance.setup`."""
        self.instance.setup(start_time, stop_time, tolerance)

    def enter_initialization_mode(self) -> None:
        """See `Instance.enter`."""
        self.instance.enter()

    def exit_initialization_mode(self) -> None:
        """See `Instance.exit`."""
        self.instance.exit()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """See `Instance.step`; false after a message when it failed."""
        try:
            self.instance.step(current_time, step_size)
        except Exception as problem:
            self.log(told(problem, self.folder), Fmi2Status.error)
            return False
        return True

    def terminate(self) -> None:
        """See `Instance.terminate`."""
        self.instance.terminate()

    def get_real(self, vrs: list[int]) -> list[float]:
        """See `Instance.get`."""
        return self.instance.get(vrs)

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """See `Instance.set`."""
        self.instance.set(vrs, values)

    def _get_fmu_state(self) -> dict[str, str]:
        return {"state": self.instance.save().hex()}

    def _set_fmu_state(self, state: dict[str, str]) -> None:
        self.instance.restore(bytes.fromhex(state["state"]))


_KNOWN: dict[str, Functions] = {}  # by the text of the card: all instances of an FMU share the functions


class SubsystemSlave(Slave):
    """A slave of a `Subsystem` of an installed package."""

    def behaviour(self) -> Behaviour:
        """The subsystem that the FMU was built from, with the numbers it was built with."""
        functions = self._functions
        return Continuous(functions, functions.face.variables)

    @cached_property
    def _functions(self) -> Functions:
        key = json.dumps(self.card)
        if key not in _KNOWN:
            sub = subsystem(self.card["origin"])
            variables = interface(sub, Values(**self.card["numbers"]))
            if fingerprint(variables) != self.card["fingerprint"]:
                raise Problem(
                    f"{self.card['name']}: {self.card['origin']} in {sys.prefix} has other equations or "
                    "variables than the FMU was built from: build the FMU again"
                )
            _KNOWN[key] = Functions(variables)
        return _KNOWN[key]


class UserSlave(Slave):
    """A slave of a model that a user wrote, in a file beside the script."""

    def behaviour(self) -> Behaviour:
        """The model in the user's file."""
        model = load(self.folder / self.card["file"])
        return Stepwise(model, face(model))
