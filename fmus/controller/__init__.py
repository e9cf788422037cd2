"""Coordinated control of the tip."""

from fmus.controller.model import CONTROLLER, controller

__all__ = ["CONTROLLER", "controller"]
