"""Many machines with different parameters at once: `batch`, and `many` for all that runs side by side."""

from orchestrator.lanes.batch import BatchResult, batch

__all__ = ["BatchResult", "batch"]
