"""FMUs whose code is Python: from the same declarations as the native ones, or from a class of a user."""

from fmus.export.python.user_model import Model, some

__all__ = ["Model", "some"]
