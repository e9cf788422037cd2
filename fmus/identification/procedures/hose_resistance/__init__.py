"""Hose resistance, section 4(b), Fig. 6: `procedure` is the experiment, `laws` are eqs. (1) and (10)."""

from fmus.identification.procedures.hose_resistance.procedure import SIGNALS, identify

__all__ = ["SIGNALS", "identify"]
