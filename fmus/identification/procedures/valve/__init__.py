"""Valve, section 4(a), Fig. 5: `procedure` is the experiment, `points`, `fit` and `law` are its steps."""

from fmus.identification.procedures.valve.procedure import SIGNALS, identify

__all__ = ["SIGNALS", "identify"]
