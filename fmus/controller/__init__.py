"""Controller: coordinated control of the tip (the end of the stick).

`controller` makes the controller of a machine from its subsystems; `CONTROLLER` is that of the default
machine.
"""

from fmus.controller.model import CONTROLLER, controller

__all__ = ["CONTROLLER", "controller"]
