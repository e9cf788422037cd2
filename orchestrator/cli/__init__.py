"""The command line `harvester`.

A command reads its options, calls one function and prints. Its imports are inside the function, and only the
file of the command that is called is imported, so that it starts fast.
"""

from importlib import import_module
from typing import Any

FILES = {  # of this folder -> commands, in the order of the help
    "build": "build crane modelica",
    "lists": "variants parameters signals",
    "check": "check diagnose",
    "run": "run reference linearize",
    "results": "validate compare plot energy",
    "studies": "convergence sweep track",
    "identify": "rig describe identify",
    "view": "view page",
}
COMMANDS = {command: file for file, commands in FILES.items() for command in commands.split()}


def application(command: str = "") -> Any:
    """The application with the commands of one file, or with all of them if there is no such command."""
    for file in [COMMANDS[command]] if command in COMMANDS else FILES:
        import_module(f"orchestrator.cli.{file}")
    app = import_module("orchestrator.cli.options").app
    app.registered_commands.sort(key=lambda made: [*COMMANDS].index(made.callback.__name__))
    return app


def __getattr__(name: str) -> Any:
    if name == "app":
        return application()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
