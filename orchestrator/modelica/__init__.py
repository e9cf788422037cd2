"""FMUs and systems of FMUs as a Modelica package: blocks, models with mechanical flanges, connected systems.

A Modelica tool that imports an FMU for Model Exchange calls it as one function of all inputs, states and
outputs, and connected FMUs become one large system of equations. Here each block calls its FMU once for each
group of outputs that depend on the same inputs, so that the tool can sort the equations and solves none.
"""

from orchestrator.modelica.modelica_package import write_package

__all__ = ["write_package"]
