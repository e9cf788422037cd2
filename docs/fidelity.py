"""Runs what docs/fidelity.md describes, fills its tables and draws: `python docs/fidelity.py [folder]`.

Ten minutes. The folder is where the machine is built, by default one that is removed at the end. The table
and the picture of examples/fidelity/README.md come from here, too.
"""

from __future__ import annotations

import csv
import importlib.util
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import fidelity_pictures as pictures
from fidelity_cases import (
    CAUSES,
    EFFECTS,
    FULL,
    IN,
    LINES,
    OUT,
    PAPER,
    SENSITIVITY,
    SPEEDS,
    TURN,
    Case,
    Test,
    Trace,
    simulate,
    within,
)
from fidelity_combinations import combinations
from fidelity_measures import modes
from fidelity_tables import (
    Outcome,
    combination_table,
    fill,
    level_table,
    measure,
    mode_table,
    peak_table,
    ripple_table,
    rows_of_costs,
    sensitivity,
)

from fmus.machine.build import harvester
from fmus.machine.parts import FAMILIES, OTHER_CIRCUITS
from orchestrator import load
from orchestrator.pages.plotting import png
from orchestrator.results.comparison import compare

HERE = Path(__file__).parent
DOCUMENT, IMAGES = HERE / "fidelity.md", HERE / "images"
SENSITIVITIES = HERE / "fidelity-sensitivity.csv"
EXAMPLE = HERE.parent / "examples" / "fidelity"
SIGNALS = ("manipulator.boom_speed", "boom_stick.boom_head_pressure", "boom_stick.stick_rod_pressure")
MACHINES: Mapping[str, tuple[float, Mapping[str, str]]] = {  # command of the stick [V], variants
    "the paper's set, at rest": (0.0, {}),
    "the paper's set": (-3.4, {}),
    "pendulum": (-3.4, {"manipulator": "pendulum"}),
    "friction": (-3.4, {"manipulator": "friction"}),
    "both detailed": (-3.4, {"boom_stick": "detailed", "swing": "detailed"}),
    "all": (-3.4, {**FULL, "manipulator": "pendulum_friction"}),
}
SHOWN = {
    "the paper's set": PAPER,
    "boom_stick detailed": EFFECTS[1],
    "pendulum": EFFECTS[3],
    "all but friction": EFFECTS[6],
    "the paper's set, boom held": next(c for c in CAUSES if c.name == "boom held"),
}


def main() -> None:
    """Everything, in a folder of the user's or a temporary one."""
    if len(sys.argv) > 1:
        everything(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            everything(Path(folder))


def everything(folder: Path) -> None:
    """Build, run, fill, draw."""
    harvester().write(folder)
    system = folder / "harvester.ssp"
    found = {c.name: measure(system, c) for c in (*EFFECTS, *LINES, *CAUSES, *SENSITIVITY)}
    tables(found, system)
    draw_all(found, system)
    costs(system)


def tables(found: Mapping[str, Outcome], system: Path) -> None:
    """Ripple, peaks, modes."""
    base = found[PAPER.name]

    def of(cases: tuple[Case, ...]) -> list[Outcome]:
        return [found[c.name] for c in cases]

    fill(DOCUMENT, "effects", ripple_table(of(EFFECTS), base))
    fill(DOCUMENT, "lines", ripple_table(of(LINES), base))
    fill(DOCUMENT, "causes", level_table(of(CAUSES)))
    fill(DOCUMENT, "peaks", peak_table(of(EFFECTS), base))
    fill(DOCUMENT, "swing lines", peak_table([measure(system, c) for c in within("swing")], base))
    with SENSITIVITIES.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(sensitivity(of(SENSITIVITY), base))
    found_modes = {name: modes(command, **swap) for name, (command, swap) in MACHINES.items()}
    fill(DOCUMENT, "modes", mode_table(found_modes))


def draw_all(found: Mapping[str, Outcome], system: Path) -> None:
    """The pictures."""

    def one(case: Case, test: Test, ramp: int) -> Trace:
        move = test.moves()[ramp]
        return simulate(system, case, [move], test.stop(move), test.pose)

    out, back = ({n: one(c, test, 0) for n, c in SHOWN.items()} for test in (OUT, IN))
    spectra = {n: (found[c.name].ripples["out"], found[c.name].ripples["in"]) for n, c in SHOWN.items()}
    pictures.ripple(out, back, spectra, IMAGES / "fidelity-ripple.png")
    turned = {
        "the paper's set": PAPER,
        "swing detailed": EFFECTS[2],
        "pendulum": EFFECTS[3],
        "all": EFFECTS[-1],
    }
    dots = {c.name.replace("`", "").replace(", ", ",\n"): found[c.name] for c in EFFECTS[1:]}
    lines = {n: one(c, TURN, 2) for n, c in turned.items()}
    pictures.swing(lines, dots, found[PAPER.name], IMAGES / "fidelity-swing.png")


def costs(system: Path) -> None:
    """What each variant costs and changes, all combinations, and the example."""
    example = _example()
    told: list[str] = []
    spent = {}
    for part in FAMILIES:
        runs, cost = example.simulate(system, part, 42.0), example.costs(system, part, 42.0)
        spent[part] = cost
        told += rows_of_costs(part, runs, cost, {n: example.states(s) for n, s in FAMILIES[part].items()})
        if part == "boom_stick":
            lines = example.table(part, runs, cost).splitlines()
            fill(EXAMPLE / "README.md", "table", "\n".join(f"    {line}" for line in lines))
            traces = {run.label: run.trace for run in runs.runs if run.label not in OTHER_CIRCUITS}
            seen = compare(traces, runs.reference.label, SIGNALS, start=10.0, stop=20.0)
            (IMAGES / "fidelity-example.png").write_bytes(png(seen.plot()))
    fill(DOCUMENT, "costs", "\n".join(told))
    variants = {part: [v for v in family if v not in OTHER_CIRCUITS] for part, family in FAMILIES.items()}
    rows = list(combinations(load(system), variants, SPEEDS, step=1e-3, record_step=0.02))
    fill(DOCUMENT, "combinations", combination_table(rows, spent))


def _example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fidelity_example", EXAMPLE / "run.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    main()
