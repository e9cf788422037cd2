"""Central differences, for FMUs that tell no derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SHIFT = 6e-6  # of the size of a value: the cube root of the rounding, where both errors of a difference meet


def differences(look: Callable[[], None], knowns: Sequence[Array], unknowns: Sequence[Array]) -> Array:
    """d(unknowns) / d(knowns), where `look` computes the one from the other, in place."""
    columns = []
    for known in knowns:
        for j, here in enumerate(known.tolist()):
            step, told = SHIFT * max(abs(here), 1.0), []
            for value in (here + step, here - step):
                known[j] = value
                look()
                told.append(np.concatenate([*unknowns]))
            columns.append((told[0] - told[1]) / ((here + step) - (here - step)))
            known[j] = here
    look()
    return np.array(columns).T.reshape(sum(map(len, unknowns)), -1)
