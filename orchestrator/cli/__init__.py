"""The command line `harvester`.

A command reads its options, calls one function and prints. Its imports are inside the function, and only the
file of the command that is called is imported, so that it starts fast.
"""

from importlib import import_module
from typing import Any

COMMANDS = (  # in the order of the help
    *(
        "build",
        "crane",
        "modelica",
        "variants",
        "parameters",
        "signals",
        "check",
        "run",
        "validate",
        "compare",
    ),
    *(
        "plot",
        "energy",
        "reference",
        "convergence",
        "rig",
        "describe",
        "identify",
        "diagnose",
        "track",
        "linearize",
        "sweep",
        "view",
        "page",
    ),
)
FILES = {  # of commands in files of another name
    **dict.fromkeys(("variants", "parameters", "signals"), "lists"),
    **dict.fromkeys(("validate", "compare", "plot", "energy"), "results"),
    **dict.fromkeys(("reference", "linearize"), "run"),
    **dict.fromkeys(("convergence", "track", "sweep"), "studies"),
    **{"rig": "identify", "describe": "identify", "page": "view"},
}


def application(command: str = "") -> Any:
    """The application with the commands of one file, or with all of them if there is no such command."""
    for name in [command] if command in COMMANDS else COMMANDS:
        import_module(f"orchestrator.cli.{FILES.get(name, name)}")
    app = import_module("orchestrator.cli.options").app
    app.registered_commands.sort(key=lambda made: COMMANDS.index(made.callback.__name__))
    return app


def __getattr__(name: str) -> Any:
    if name == "app":
        return application()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
