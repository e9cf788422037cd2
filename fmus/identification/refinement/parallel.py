"""Many jobs in a few threads; the compiled model lets go of the interpreter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def parallel(job: Callable[[Job], Result], places: Sequence[Job], threads: int) -> list[Result]:
    """Results in the order of the places; an interrupt does not wait for what has not begun."""
    if threads == 1 or len(places) == 1:
        return [job(place) for place in places]
    pool = ThreadPoolExecutor(threads)
    try:
        return list(pool.map(job, places))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
