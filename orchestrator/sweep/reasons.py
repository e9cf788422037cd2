"""Reasons of failed runs that say the same but for the numbers in them."""

from __future__ import annotations

import re

import pandas as pd

# a number that stands alone: those inside a name, such as swing_1_rise, tell what the name is of
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def alike(reasons: pd.Series) -> pd.Series:
    """Each reason with its numbers masked: equal ones are of one kind."""
    return reasons.astype(str).map(lambda reason: _NUMBER.sub("#", reason))
