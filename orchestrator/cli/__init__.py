"""The command line `harvester`: one file per command, in the order of the help.

A command reads its options, calls one function and prints. Its imports are inside the function,
so that --help stays fast.
"""

# isort: off
from orchestrator.cli import build, modelica, lists, check  # noqa: F401
from orchestrator.cli import run, validate, compare, plot, reference, convergence  # noqa: F401
from orchestrator.cli import rig, identify, track, linearize, sweep, view, page  # noqa: F401
from orchestrator.cli.options import app

__all__ = ["app"]
