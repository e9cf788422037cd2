"""What this machine has room for: memory, and the refusal of results that cannot fit before they exist."""

import os
import shutil
from pathlib import Path

from orchestrator.base.errors import Problem

NUMBER = 8  # bytes of a float64; a CSV file has up to 24 characters for it, and rarely less than 8


def machine_memory() -> float:
    """Memory of this machine [bytes]; infinite if unknown."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def size_text(rows: int, signals: int) -> str:
    """How much the rows of a trace are, in words."""
    return f"{rows:.3g} points of {signals} signals, {NUMBER * rows * (signals + 1) / 1e9:.2g} GB"


def check_room(rows: int, signals: int, folder: Path | None = None) -> None:
    """Refuse rows that do not fit on the disk of a folder, or into memory if there is none."""
    free = shutil.disk_usage(folder).free if folder else machine_memory()
    if NUMBER * rows * (signals + 1) > free:
        where = f"on the disk of {folder}" if folder else "into memory"
        advice = "choose a longer record step or stop earlier"
        raise Problem(f"{size_text(rows, signals)}, do not fit {where}, {free / 1e9:.2g} GB; {advice}")
