"""Electrical actuation of the valves: what is between a command in volts and the spool."""

from fmus.valve_actuation.model import ACTUATION, actuation

__all__ = ["ACTUATION", "actuation"]
