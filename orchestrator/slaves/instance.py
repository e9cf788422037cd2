"""One instance of a co-simulation FMU: how it is loaded, initialised and freed."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import ClassVar

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.slaves.calls import Calls
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import ERROR, Log
from orchestrator.slaves.standard import STANDARDS, Open
from orchestrator.system.interface import Interface

LOGGED = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class Instance:
    """An instance from its instantiation to its end.

    standards   how each version of FMI is spoken; another kind of instance has its own
    """

    standards: ClassVar[Mapping[int, Open]] = STANDARDS

    def __init__(self, name: str, interface: Interface, fmu: Location) -> None:
        self.name, self.interface, self.log = name, interface, Log(name)
        self._label, self._stepping = f"{name} ({fmu})", False
        self._undo = ExitStack()
        try:
            self._open(fmu)
        except BaseException:
            self.close()
            raise

    def _open(self, fmu: Location) -> None:
        folder = fmu.path.resolve() if fmu.is_folder else Path(tempfile.mkdtemp(prefix="fmu-"))
        if not fmu.is_folder:
            self._undo.callback(shutil.rmtree, folder, ignore_errors=True)
            fmu.extract(folder)
        library = Library(folder, self.interface.identifier, self._label, self.interface.fmi)
        self._fmi = self.standards[self.interface.fmi](self.interface, self.log)
        self.calls = Calls(library, self._fmi.prefix, self.log)
        self._undo.callback(self.calls.unless_fatal, library.close)
        self._undo.callback(self._fmi.release)
        handle = self._fmi.instantiate(library, folder, False) or self._fmi.instantiate(library, folder, True)
        if not handle:  # the second, verbose try made it say what is wrong
            raise Problem(f"{self._label}: the FMU could not be instantiated{self.log.last()}")
        self.calls.handle = ctypes.c_void_p(handle)
        self._undo.callback(self.calls.unless_fatal, self.calls.function("FreeInstance", None))
        self._listen()

    def _listen(self) -> None:
        """Ask for warnings and errors, not for the rest."""
        wanted = [c.encode() for c in LOGGED if c in self.interface.categories]
        if wanted:
            array = (ctypes.c_char_p * len(wanted))(*wanted)
            on = self._fmi.types["Boolean"](1)
            with suppress(Problem):  # an FMU that cannot choose its messages still runs
                self.calls.function("SetDebugLogging")(on, ctypes.c_size_t(len(wanted)), array)

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        self.log.time = start
        self._fmi.setup(self.calls, start, stop, tolerance)

    def enter(self) -> None:
        """Enter initialisation mode."""
        self._fmi.enter(self.calls)

    def exit(self) -> None:
        """Leave initialisation mode; steps may follow."""
        self.calls.call("ExitInitializationMode")
        self._stepping = True

    def close(self) -> None:
        """Terminate and free the instance, unload the library, remove the unpacked files. May be repeated."""
        if self._stepping and self.calls.worst < ERROR:
            self._stepping = False
            with suppress(Problem):
                self.calls.call("Terminate")
        self._undo.close()
