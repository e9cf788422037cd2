"""Diagnosis of a machine from the readings of its controller: what is broken, how much, and how certain.

model.py      the subsystem, and what concerns all functions: lines, pump, oil, payload
axis.py       one function as its readings show it, and what a check is
leaks.py, valves.py, sensors.py, weight.py      the checks of one function
estimates.py  least squares with a fading memory, and when a size is told
settings.py   limits and time constants from settings.toml, with their reasons
"""

from fmus.diagnosis.model import NAME, diagnosis, findings

__all__ = ["NAME", "diagnosis", "findings"]
