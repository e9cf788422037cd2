"""Damping, section 4(d), eq. (13), Fig. 9: `procedure`, one `joint` at a time, (13) `as_printed`."""

from fmus.identification.procedures.damping.procedure import SIGNALS, identify

__all__ = ["SIGNALS", "identify"]
