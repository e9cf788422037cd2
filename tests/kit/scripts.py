"""Scripts beside the pages."""

import runpy
import sys
from pathlib import Path
from typing import Any


def names_of(script: Path) -> dict[str, Any]:
    """The names of a script that may import its neighbours, as if it were run.

    Its folder does not stay on the search path, where docs/control.py would hide the package python-control.
    """
    before = [*sys.path]
    sys.path.insert(0, str(script.parent))
    try:
        return runpy.run_path(str(script))
    finally:
        sys.path[:] = before
