"""Where a replay stands, and the way to another place of it."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from orchestrator.view.session import Session

STEP = 0.001  # of the file; a knob that stands nearer than this is not moved


class Seek:
    """A slider over the share of the file that is over; hidden while the machine is live."""

    def __init__(self, session: Session) -> None:
        self._session, self._held = session, False
        self._slider = ui.slider(min=0.0, max=1.0, step=STEP, value=0.0).classes("seek").mark("seek")
        self._slider.props('dense aria-label="Time of the replay"')
        self._slider.on("pan", self._pan)
        self._slider.on("change", self._go)

    def show(self, t: float) -> None:
        """Follow the replay, unless somebody holds the knob."""
        span = self._session.span
        self._slider.set_visibility(span is not None)
        if span is None or self._held:
            return
        share = (t - span[0]) / max(span[1] - span[0], 1e-9)
        if abs(self._slider.value - share) > STEP:
            self._slider.value = share

    def _pan(self, event: Any) -> None:
        self._held = event.args == "start"

    def _go(self, event: Any) -> None:
        if (span := self._session.span) is not None:
            self._session.seek(span[0] + float(event.args) * (span[1] - span[0]))
