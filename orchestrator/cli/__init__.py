"""The command line `harvester`. Thin: each command imports what it needs when it runs."""

from orchestrator.cli import models, simulation, measurements, tracking, control, studies, view  # isort: skip  # as the help
from orchestrator.cli.app import app

__all__ = ["app", "control", "measurements", "models", "simulation", "studies", "tracking", "view"]
