"""A, B, C, D of a whole system of FMUs at an operating point, and the modes of it.

from orchestrator import linearize

linear = linearize("build/harvester.ssp", parameters=["reach"], inputs=["boom_command"])
print(linear.text())
"""
