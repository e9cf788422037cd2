"""All chosen parameters together against recorded traces: output error by multiple shooting."""
