"""FMUs whose code is Python: of a `Model` that a user writes."""

from fmus.export.python.user_model import Model, subgroup

some = subgroup  # its name until version 0.1

__all__ = ["Model", "some", "subgroup"]
