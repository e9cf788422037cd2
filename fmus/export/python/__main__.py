"""python -m fmus.export.python my_actuator.py: an FMU of a user's file, or of a subsystem by its name."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from fmus.contract import ModelError
from fmus.export.platforms import select
from fmus.export.python.build import build_python, build_user
from fmus.export.python.origin import subsystem


def main(arguments: list[str] | None = None) -> int:
    """Exit status."""
    parser = argparse.ArgumentParser("python -m fmus.export.python", description="Build an FMU in Python.")
    parser.add_argument(
        "model", help="a file with a class of Model, or a subsystem such as fmus.boom_stick:VARIANTS.lumped"
    )
    parser.add_argument("--out", type=Path, default=Path("build"), help="folder of the FMU [build]")
    parser.add_argument("--step", type=float, default=1e-3, help="suggested communication step [s]")
    parser.add_argument("--stop", type=float, default=10.0, help="suggested stop time [s]")
    parser.add_argument("--platform", action="append", default=[], help="host (the default), all, or names")
    given = parser.parse_args(arguments)
    rest = given.out, given.step, given.stop
    try:
        platforms = select(given.platform or ["host"])
        if given.model.endswith(".py"):
            path = build_user(Path(given.model), *rest, platforms=platforms)
        else:
            found = subsystem(given.model)
            path = build_python(found, *rest, platforms=platforms, where=given.model)
    except (ModelError, OSError) as problem:
        print(problem, file=sys.stderr)
        return 1
    print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
