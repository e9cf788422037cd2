"""The tables, and the same as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from benchmarks.peers.cases import Case
from benchmarks.peers.measure import Equal, Job, at_error
from benchmarks.peers.settings import USUAL, Setting

Found = Mapping[str, Sequence[Job]]  # label of a setting -> its jobs in one case
NONE = "-"


def table(case: Case, settings: Sequence[Setting], found: Found) -> Table:
    """Cost of a step, error of each step, and cost at equal error."""
    values = sorted({job.value for jobs in found.values() for job in jobs if job.setting.vary == "step"})
    out = Table(title=case.title, title_justify="left", caption_justify="left", caption=_failures(found))
    out.add_column("", no_wrap=True)
    for head in ("us/step", "not rec.", *(f"{value * 1e3:g} ms" for value in values)):
        out.add_column(head, justify="right")
    for head in (f"ms/s at {case.target:g}", "step, ms", "to best peer"):
        out.add_column(head, justify="right")
    best = best_peer(case, settings, found)
    for setting in settings:
        jobs = found.get(setting.label, ())
        if jobs:
            out.add_row(setting.label, *_costs(jobs), *_errors(jobs, values), *_equal(case, jobs, best))
    return out


def best_peer(case: Case, settings: Sequence[Setting], found: Found) -> float:
    """Least time for a simulated second at the target error of the peers [ms]; NaN where none has it."""
    equals = (at_error(found.get(s.label, ()), case.target) for s in settings if not s.ours)
    return min((equal.per_second for equal in equals if equal), default=math.nan)


def plain(case: Case, settings: Sequence[Setting], found: Found) -> dict[str, Any]:
    """All figures of a case."""
    return {
        "title": case.title,
        "simulated": case.stop,
        "target": case.target,
        "settings": [
            {
                "label": setting.label,
                "ours": setting.ours,
                "options": dict(setting.options),
                "at_target": _fields(at_error(found[setting.label], case.target)),
                "runs": [_run(job) for job in found[setting.label]],
            }
            for setting in settings
            if found.get(setting.label)
        ],
    }


def _run(job: Job) -> dict[str, Any]:
    finite = job.error is not None and math.isfinite(job.error)
    return {
        job.setting.vary: job.value,
        "recorded": job.record,
        "error": job.error if finite else None,
        "lost": job.error is not None and not finite,
        "steps": job.steps,
        "us_per_step": job.per_step if job.runs else None,
        "ms_per_second": job.per_second if job.runs else None,
        "wall": [run.wall for run in job.runs],
        "cpu": [run.cpu for run in job.runs],
        "failed": job.failed,
    }


def _fields(equal: Equal | None) -> dict[str, float] | None:
    return {"value": equal.value, "ms_per_second": equal.per_second} if equal else None


def _costs(jobs: Sequence[Job]) -> list[str]:
    usual = {j.record: j.per_step for j in jobs if j.value == USUAL and j.setting.vary == "step" and j.runs}
    return [f"{usual[record]:.1f}" if record in usual else NONE for record in (True, False)]


def _errors(jobs: Sequence[Job], values: Sequence[float]) -> list[str]:
    errors = {j.value: j.error for j in jobs if j.record and j.setting.vary == "step"}
    return [_error(errors[value]) if value in errors else NONE for value in values]


def _error(error: float | None) -> str:
    return NONE if error is None else f"{error:.1e}" if math.isfinite(error) else "lost"


def _equal(case: Case, jobs: Sequence[Job], best: float) -> list[str]:
    equal = at_error(jobs, case.target)
    if not equal:
        return [NONE, NONE, NONE]
    step = f"{equal.value * 1e3:.3g}" if jobs[0].setting.vary == "step" else NONE
    return [f"{equal.per_second:.3g}", step, f"{equal.per_second / best:.2f}"]


def _failures(found: Found) -> str | None:
    told = {
        f"{j.setting.label}, {j.value:g}: {j.failed}" for jobs in found.values() for j in jobs if j.failed
    }
    lines = sorted(line for line in told if "NoChoice" not in line)
    return "\n".join(lines) or None
