"""Many machines with different parameters at once: `batch`."""

from orchestrator.lanes.batch import BatchResult, batch

__all__ = ["BatchResult", "batch"]
