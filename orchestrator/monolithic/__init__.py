"""Solves a system of FMUs in Model Exchange as one ODE, with its events: the limit of all co-simulations.

from orchestrator import reference

result = reference("build/harvester.ssp", "data/scenarios/work_cycle.csv")
"""
