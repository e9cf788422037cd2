"""What the process of a live machine is told when it starts."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.live.setup import Setup


@dataclass(frozen=True)
class Task:
    """Handed over through the pipe.

    address   of the shared memory
    rows      frames that it holds
    first     number of the first frame
    serial    of the last command that is not for this session
    folder    for temporary files
    """

    setup: Setup
    address: str
    rows: int
    first: int
    serial: int
    folder: str
