"""What differs between versions of FMI, as one interface."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from orchestrator.slaves.calls import Calls
from orchestrator.slaves.fmi2 import Fmi2
from orchestrator.slaves.fmi3 import Fmi3
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import Log
from orchestrator.system.interface import Interface


class Standard(Protocol):
    """One version of FMI.

    prefix, state, thaw, slopes   how functions are called
    types                         word in a function's name -> ctypes type
    results, places               further arguments of fmiXDoStep, for what it says about a step; addresses
    flags                         not zero after a step that wants something
    """

    prefix: str
    state: str
    thaw: str
    slopes: str
    types: dict[str, Any]
    results: tuple[Any, ...]
    places: tuple[int, ...]
    flags: ctypes.c_uint32
    release: Callable[[], None]

    def instantiate(self, library: Library, folder: Path, verbose: bool) -> int | None: ...
    def array(self, address: ctypes.c_void_p, count: int) -> tuple[Any, ...]: ...
    def setup(self, calls: Calls, start: float, stop: float, tolerance: float | None) -> None: ...
    def enter(self, calls: Calls) -> None: ...
    def stepped(self, calls: Calls, status: int) -> None: ...


Open: TypeAlias = Callable[[Interface, Log], Standard]
STANDARDS: Mapping[int, Open] = {2: Fmi2, 3: Fmi3}
