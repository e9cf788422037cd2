"""Draws and fills in docs/convergence.md and the tables of examples/hydraulic_manipulator: minutes.

    python docs/convergence.py                       # builds the machine first
    python docs/convergence.py build/harvester.ssp   # takes one that is built
    python docs/convergence.py --peers               # only the figure and the table of `make bench-peers`

The same studies by commands: `harvester convergence`, and `python examples/hydraulic_manipulator/steps.py`.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from pathlib import Path

from orchestrator.pages.plotting import draw, png
from orchestrator.studies.convergence.convergence_report import error_table, figure
from orchestrator.studies.convergence.convergence_study import ConvergenceStudy, convergence

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "hydraulic_manipulator"
IMAGES = ROOT / "docs" / "images"
PAGE = ROOT / "docs" / "convergence.md"
PEERS = ROOT / "build" / "peers.csv"  # as `make bench-peers` writes it
NUMBERS = ROOT / "docs" / "error-and-cost.csv"  # the same, beside the page
STEPS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)  # [s]
DPI = 110

sys.path[:0] = [str(EXAMPLE), str(ROOT)]  # scripts, not installed packages


def main() -> None:
    """Draw and fill in what was asked for."""
    if PEERS.exists():
        peers()
    if "--peers" not in sys.argv:
        studies()


def peers() -> None:
    """Figure and table of all tools."""
    from benchmarks.peers.figure import draw as draw_peers
    from benchmarks.peers.figure import equal_table, read_csv

    shutil.copyfile(PEERS, NUMBERS)
    rows = read_csv(NUMBERS)
    draw_peers(rows, IMAGES / "error-and-cost.png")
    fill(PAGE, "equal error", equal_table(rows))


def studies() -> None:
    """Run both studies, draw, fill in the tables."""
    from machine import build
    from steps import beside_the_published, length_table, manipulator

    from fmus.machine.build import data, harvester

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        machine = Path(sys.argv[1]) if len(sys.argv) > 1 else folder / "harvester.ssp"
        if len(sys.argv) < 2:
            harvester().write(folder)
        usual = data("reference/work_cycle.csv")
        cycle = convergence(machine, folder / "cycle", STEPS, default_reference=usual)
        systems = build(folder / "manipulator")
        benchmark = manipulator(systems["rates"])
        beside_the_published(systems, EXAMPLE / "steps.png")
    picture("work-cycle", cycle)
    picture("m1", benchmark)
    fill(PAGE, "work cycle, speed", error_table(cycle, "speed").markdown())
    fill(EXAMPLE / "README.md", "M1, pressure", error_table(benchmark, "pressure").markdown())
    fill(EXAMPLE / "README.md", "M1, length", length_table(benchmark).markdown())


def picture(name: str, study: ConvergenceStudy) -> None:
    """Error over step."""
    IMAGES.joinpath(f"convergence-{name}.png").write_bytes(
        png(draw(figure(study, next(iter(study.groups)))), DPI)
    )


def fill(document: Path, name: str, table: str) -> None:
    """Put a table in its place, between <!-- name --> and <!-- end -->."""
    text = document.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(\n<!-- end -->)", re.DOTALL)
    if not place.search(text):
        raise SystemExit(f"{document}: expected a place <!-- {name} -->")
    filled = place.sub(lambda match: match[1] + table + match[2], text)
    document.write_text(filled, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
