"""The command line itself; the modules beside this one put the commands into it."""

from __future__ import annotations

from pathlib import Path

import typer

BUILD = Path("build")
SYSTEM = BUILD / "harvester.ssp"

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def _group() -> None:
    """An electrohydraulic harvester as FMUs: build, co-simulate, validate."""
