"""Tries out one FMU in a process of its own: what a child process of `orchestrator.check.probes` runs.

Needs the standard library only and so starts within a twentieth of a second; a check starts some forty.
"""
