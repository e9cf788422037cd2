"""Motor leakage, section 4(d), eqs. (11), (12), Fig. 8: `procedure` fits the `points`."""

from fmus.identification.procedures.motor_leakage.procedure import SIGNALS, identify

__all__ = ["SIGNALS", "identify"]
