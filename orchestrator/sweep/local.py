"""A Dask cluster of this process: its workers are threads, and nothing listens on the network.

`distributed.LocalCluster` would open a page of the scheduler and one of each worker to the network, also
without a dashboard.
"""

from __future__ import annotations

from typing import Any

from distributed import Scheduler, SpecCluster, Worker


class _Private:
    """Without pages."""

    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Open no port."""


class _Scheduler(_Private, Scheduler):  # type: ignore[misc]  # Dask has no types
    pass


class _Worker(_Private, Worker):  # type: ignore[misc]  # Dask has no types
    pass


def local(workers: int) -> SpecCluster:
    """A cluster of so many workers with one thread each, which look after processes of their own."""
    inside = {"host": None, "protocol": "inproc", "dashboard": False}
    worker = {"cls": _Worker, "options": {**inside, "nthreads": 1, "memory_limit": 0}}
    return SpecCluster(
        scheduler={"cls": _Scheduler, "options": {**inside, "port": 0}},
        workers=dict.fromkeys(range(workers), worker),
        worker=worker,
        silence_logs=False,
    )
