"""Where a run begins, beside the reference whose commands it plays."""

from __future__ import annotations

import numpy as np

from orchestrator.files.trace import Trace
from orchestrator.symbols import linear
from orchestrator.validation.reference import Reference

POSITIONS = ("rad", "m")
APART = 0.05  # of what the reference moves: more than noise and settling


def begins_elsewhere(run: Trace, reference: Reference) -> str:
    """A sentence on positions at which a run begins, if they are not those of the reference; else nothing.

    Commands alone do not say where a machine stands, and from another pose it answers them differently.
    """
    off, moved = {}, 0.0
    for name, signal in reference.signals.items():
        unit = run.units.get(name, "")
        if name not in run.signals or unit not in POSITIONS:
            continue
        factor, offset = linear(signal.unit, unit, name)
        values = factor * signal.values + offset
        begin = float(np.interp(run.time[0], reference.time, values))
        off[f"{name} by {run[name][0] - begin:.3g} {unit}"] = abs(run[name][0] - begin)
        moved = max(moved, float(np.ptp(values)))
    far = ", ".join(text for text, apart in off.items() if apart > APART * moved)
    return f"the run begins elsewhere than the reference: {far}; --set gives a start" if far else ""
