"""What went wrong, in one line, with the place in the user's file."""

from __future__ import annotations

import traceback
from pathlib import Path

from fmus.contract import ModelError


def told(problem: BaseException, folder: Path) -> str:
    """The text of a ModelError; of another exception also its kind, file and line.

    The place is the last one in `folder`, where the FMU's own scripts are, else the last one of all.
    """
    text = " ".join(str(problem.msg if isinstance(problem, SyntaxError) else problem).split())
    if isinstance(problem, ModelError):
        return text
    kind = type(problem).__name__
    return f"{place(problem, folder)}{kind}: {text}" if text else f"{place(problem, folder)}{kind}"


def place(problem: BaseException, folder: Path) -> str:
    """File and line of an exception, as "file.py:12: "; empty when it has none."""
    if isinstance(problem, SyntaxError) and problem.filename:
        return f"{Path(problem.filename).name}:{problem.lineno}: "
    frames = traceback.extract_tb(problem.__traceback__)
    own = [f for f in frames if Path(f.filename).parent == folder]
    return "".join(f"{Path(f.filename).name}:{f.lineno}: " for f in (own or frames)[-1:])
