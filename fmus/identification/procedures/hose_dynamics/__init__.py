"""Hose inertance and capacitance, section 4(c), Fig. 7: `procedure`, by `equations` and by `definition`."""

from fmus.identification.procedures.hose_dynamics.procedure import SIGNALS, identify

__all__ = ["SIGNALS", "identify"]
