"""A progress bar that appears only when a run takes longer than a second."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any

PATIENCE = 1.0  # [s]


class Progress:
    """Shows how much of `total` [s] is simulated; silent when not wanted or when the run is short."""

    def __init__(self, total: float, wanted: bool) -> None:
        self._total, self._wanted = total, wanted
        self._began = time.perf_counter()
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, done: float) -> None:
        """`done` [s] are simulated now."""
        if not self._wanted or (self._bar is None and time.perf_counter() - self._began < PATIENCE):
            return
        if self._bar is None:
            self._open()
        self._bar.update(self._task, completed=done)

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        text = TextColumn("{task.completed:.2f} of {task.total:g} s simulated")
        console = Console(stderr=True)
        self._bar = Bar(text, BarColumn(), TimeRemainingColumn(), console=console, transient=True)
        self._task = self._bar.add_task("run", total=self._total)
        self._bar.start()
