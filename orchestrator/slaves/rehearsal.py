"""What the description of an FMU leaves open, found out on an instance that nobody uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from orchestrator.errors import Problem
from orchestrator.slaves.slave import Call

if TYPE_CHECKING:
    from orchestrator.slaves.fmu import FmuSlave


class Rehearsal:
    """Tries calls; an instance that refused one is given up, because an error may have broken it."""

    def __init__(self, fresh: Callable[[], FmuSlave]) -> None:
        """fresh: makes an instance that is ready for its first step, or raises Problem."""
        self._fresh, self._able = fresh, True
        self._instance: FmuSlave | None = None

    def passes(self, ask: Callable[[FmuSlave], Call]) -> bool | None:
        """Does the FMU do this without a complaint? None: there is no instance to try it on."""
        instance = self._ready()
        if instance is None:
            return None
        try:
            ask(instance)()
        except Problem:
            self.end()
            return False
        return instance.calls.worst == 0

    def _ready(self) -> FmuSlave | None:
        if self._instance is None and self._able:
            try:
                self._instance = self._fresh()
            except Problem:
                self._able = False
        return self._instance

    def end(self) -> None:
        """Free the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None
