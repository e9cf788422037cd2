"""Many machines with different parameters at once: `batch`."""
