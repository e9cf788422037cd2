"""Diagnosis of a machine from the readings of its controller: what is broken, how much, and how certain.

model.py      the subsystem, and what concerns all functions: lines, pump, oil
unknowns.py   the table of what may be broken; limits and time constants (settings.toml, with their reasons)
estimates.py  states, least squares with a fading memory, cumulative sums, and when a size is told
readings.py   one function as its readings show it, and its sensors
losses.py, valves.py, weight.py      residuals of one function: oil that is lost, its valve, its load
"""

from fmus.diagnosis.model import diagnosis
from fmus.diagnosis.unknowns import findings

__all__ = ["diagnosis", "findings"]
