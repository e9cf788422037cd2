"""Writes FMUs and systems of FMUs as a Modelica package: blocks, models with flanges, connected systems.

The usual import for Model Exchange calls an FMU as one function of all inputs, states and outputs, so that
connected FMUs become one large system of equations. Here a block calls its FMU once for each group of outputs
with the same dependencies. The tool can then sort the equations and need not solve any.
"""

from orchestrator.modelica.modelica_package import write_package

__all__ = ["write_package"]
