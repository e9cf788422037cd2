"""How long a step takes inside the FMUs, for orientation: no master can be faster.

What the FMUs get at the usual step is played into them by a C program, compiled together with their sources.
"""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path

from benchmarks.peers.cases import Case
from benchmarks.peers.settings import USUAL
from benchmarks.variants import nanoseconds
from orchestrator import run


def inside(case: Case) -> dict[str, float]:
    """Component -> time of a step [us], its inputs set before it; those without fed inputs are left out."""
    trace = run(case.system, step=USUAL, stop=case.stop).trace
    fed: dict[str, list[str]] = {}
    for part, _, name in (end.partition(".") for end in case.fed):
        fed.setdefault(part, []).append(name)
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(case.system) as archive:
        files = {part: archive.extract(f"resources/{part}.fmu", folder) for part in fed}
        return {part: nanoseconds(Path(files[part]), part, fed[part], trace) / 1e3 for part in fed}
