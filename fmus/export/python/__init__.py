"""FMUs whose code is Python: from the same declarations as the native ones, or from a class of a user."""
