"""Inertial parameters from motion and torque: `procedure`, and the `base_parameters`."""

from fmus.identification.procedures.inertia.procedure import SIGNALS, identify

__all__ = ["SIGNALS", "identify"]
