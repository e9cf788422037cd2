"""Linearises a system of FMUs at an operating point: matrices A, B, C, D and modes.

from orchestrator import linearize

linear = linearize("build/harvester.ssp", parameters=["reach"], inputs=["boom_command"])
print(linear.text())
"""
