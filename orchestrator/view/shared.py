"""What all pages show alike and is computed once: the history and the pace."""

from __future__ import annotations

from orchestrator.live.setup import Frame
from orchestrator.view.panels.charts import NAMES
from orchestrator.view.panels.history import History
from orchestrator.view.panels.state import Clock
from orchestrator.view.session import Session


class Shared:
    """Renewed at each look; begins anew with another machine.

    reading   the one that the history belongs to
    looks     how many there were
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.looks = 0
        self._begin()

    def look(self, frame: Frame) -> None:
        """Before the pages are told."""
        if self.reading is not self._session.reading:
            self._begin()
        self.looks += 1
        self.history.look()
        self.clock.look(frame)

    def _begin(self) -> None:
        self.reading = self._session.reading
        self.history = History(self._session.machine, self.reading, NAMES)
        self.clock = Clock()
