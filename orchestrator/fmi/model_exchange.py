"""One instance of an FMU for model exchange: states and time are given, derivatives are told.

Co-simulation would do for the derivatives alone, but there nobody can choose the states.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from fmpy.fmi2 import fmi2EventInfo
from lxml import etree

from orchestrator.base.errors import Problem
from orchestrator.fmi.calls import Buffer, Calls, address
from orchestrator.fmi.instance import BoundInstance
from orchestrator.fmi.library import Library, logger3
from orchestrator.fmi.versions import Fmi2, Fmi3, Open
from orchestrator.ssp.system import Component

ROUNDS = 100  # of event iteration; a model that wants more never settles


class Exchange2(Fmi2):
    """An instance of FMI 2.0 for model exchange."""

    kind = 0

    def settle(self, calls: Calls) -> bool:
        """One round of event iteration; is another one wanted?"""
        info = fmi2EventInfo()
        calls.call("NewDiscreteStates", ctypes.byref(info))
        return bool(info.newDiscreteStatesNeeded)


class Exchange3(Fmi3):
    """An instance of FMI 3.0 for model exchange."""

    def instantiate(self, library: Library, folder: Path, verbose: bool) -> int | None:
        """The handle of a new instance."""
        create = library.function("fmi3InstantiateModelExchange", ctypes.c_void_p)
        resources = folder / "resources"
        path = f"{resources}/".encode() if resources.is_dir() else None
        names = self._log.component.encode(), self._interface.guid.encode()
        flags = ctypes.c_bool(False), ctypes.c_bool(verbose)
        handle: int | None = create(*names, path, *flags, ctypes.c_void_p(self._environment.key), logger3)
        return handle

    def settle(self, calls: Calls) -> bool:
        """One round of event iteration; is another one wanted?"""
        flags, when = [ctypes.c_bool() for _ in range(5)], ctypes.c_double()
        calls.call("UpdateDiscreteStates", *(ctypes.byref(f) for f in flags), ctypes.byref(when))
        return flags[0].value


class ExchangeSlave(BoundInstance):
    """An FMU whose states are set from outside; variables are read and set as those of any slave."""

    standards: ClassVar[Mapping[int, Open]] = {2: Exchange2, 3: Exchange3}
    _fmi: Any

    def exit(self) -> None:
        """Leave initialisation mode, handle the events of the start, and be ready to be asked."""
        super().exit()
        for _ in range(ROUNDS):
            if not self._fmi.settle(self.calls):
                self.calls.call("EnterContinuousTimeMode")
                return
        raise Problem(f"{self._label}: its discrete states do not settle at the start")

    def put(self, states: Buffer) -> None:
        """Set the continuous states, shape (n,)."""
        if len(states):
            self.calls.call("SetContinuousStates", address(states), ctypes.c_size_t(len(states)))

    def at(self, time: float) -> None:
        """Set the time [s]."""
        self.log.time = time
        self.calls.call("SetTime", ctypes.c_double(time))


def open_exchange(component: Component) -> ExchangeSlave:
    """An instance of the component's FMU for model exchange; raises Problem where it is not made for it."""
    face, source = component.interface, component.source
    if source is None:
        raise Problem(f"{component.name}: has no FMU file")
    description = etree.fromstring(source.member("modelDescription.xml").read())
    declared = description.find("ModelExchange")
    if declared is None:
        found = "got one for co-simulation only"
        raise Problem(f"{component.name} ({source}): expected an FMU for model exchange as well, {found}")
    if not (face.states or face.stateless):
        raise Problem(f"{component.name} ({source}): expected a list of its continuous states, got none")
    told = declared.get(f"providesDirectionalDerivative{'s' * (face.fmi == 3)}", "false")
    own = replace(face, identifier=declared.get("modelIdentifier"), directional=told in ("true", "1"))
    return ExchangeSlave(component.name, own, source)
