"""Controller: coordinated control of the tip (the end of the stick)."""

from fmus.controller.model import CONTROLLER, controller

__all__ = ["CONTROLLER", "controller"]
