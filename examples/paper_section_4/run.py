"""Section 4 of the paper as printed, next to this project's estimates and the truth: `run.py recordings`.

The recordings are those of `harvester rig --machine lumped`, whose true values are in the parameter files.
With `--seeds` the bench experiments of Figs. 6 to 8 are recorded again with other noise, to count how many
intervals contain the truth.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from as_printed import Known, Printed, printed
from panels import draw

from fmus.identification.procedures.damping import DAMPING
from fmus.identification.procedures.hoses import HOSE_DYNAMICS, HOSE_RESISTANCE
from fmus.identification.procedures.motor_leakage import MOTOR_LEAKAGE
from fmus.identification.recordings.reading import read_folder
from fmus.identification.results import Estimate
from fmus.machine.parts import FERIC
from fmus.parameters import complete
from fmus.rig.experiments import EXPERIMENTS, experiment
from fmus.rig.recordings import write
from orchestrator.base.errors import Problem
from orchestrator.base.text import TextTable
from orchestrator.data.recording import Recording

PROCEDURES = (HOSE_RESISTANCE, HOSE_DYNAMICS, MOTOR_LEAKAGE, DAMPING)
REPEATED = ("hose_", "motor_")  # experiments of Figs. 6 to 8
HEAD = ("Fig.", "parameter", "true", "printed", "off %", "+- %", "holds", "ours", "off %", "+- %", "holds")
COUNTS = ("Fig.", "parameter", "off %", "by samples", "hold", "by groups", "hold", "ours", "hold")
Pair = tuple[Printed, Estimate, float]  # of one parameter: as printed, ours, true


def true_values() -> Known:
    """All parameters of the lumped machine, `part.name`."""
    return {
        f"{sub.name}.{name}": number
        for sub in FERIC.subsystems.values()
        for name, number in complete(sub)["parameters"].items()
    }


def compared(recordings: Sequence[Recording], known: Known) -> Iterator[Pair]:
    """Each parameter of section 4 that both estimate; what is not estimated has its true value."""
    ours: dict[str, Estimate] = {}
    for procedure in PROCEDURES:
        with suppress(Problem):  # no recording
            ours |= {e.name.rpartition(".")[2]: e for e in procedure.identify(recordings, known).estimates}
    for one in printed(recordings, known):
        name = one.by_samples.name
        if estimate := ours.get(name.rpartition(".")[2]):
            yield one, estimate, known[name].value


def holds(estimate: Estimate, true: float) -> bool:
    """Whether the interval contains the truth."""
    return estimate.low <= true <= estimate.high


def percent(share: float, sign: str = "") -> str:
    """A share in percent with three significant digits."""
    return f"{100 * share:{sign}.3g}" if np.isfinite(share) else "-"


def half(estimate: Estimate, true: float) -> float:
    """Half the interval over the truth."""
    return (estimate.high - estimate.low) / 2 / true


def table(pairs: Sequence[Pair]) -> str:
    """A line for each parameter: truth, the paper's estimate with its interval by samples, ours."""
    rows = []
    for one, own, true in pairs:
        row = [str(one.figure), one.by_samples.name.rpartition(".")[2], f"{true:.3e}"]
        for e in (one.by_samples, own):
            off = percent(e.value / true - 1, "+")
            row += [f"{e.value:.3e}", off, percent(half(e, true)), "yes" if holds(e, true) else "no"]
        rows.append(row)
    return "\n".join(TextTable(HEAD, rows, left=(0, 1)).lines())


def repeated(seeds: int, known: Known) -> Iterator[list[Pair]]:
    """The comparison for each seed of the noise, on the bench experiments."""
    names = [name for name in EXPERIMENTS if name.startswith(REPEATED)]
    for seed in range(seeds):
        with TemporaryDirectory() as folder:
            for name in names:
                write(Path(folder), experiment(name, "lumped"), seed)
            yield list(compared(read_folder(folder), known))


def counted(found: Sequence[Sequence[Pair]]) -> str:
    """A line for each parameter: mean error as printed; half width and number of intervals that hold."""
    rows = []
    for pairs in zip(*found, strict=True):
        first, _, true = pairs[0]
        error = np.mean([one.by_samples.value / true - 1 for one, _, _ in pairs])
        row = [str(first.figure), first.by_samples.name.rpartition(".")[2], percent(float(error), "+")]
        for every in zip(*((one.by_samples, one.by_groups, own) for one, own, _ in pairs), strict=True):
            width = float(np.median([half(e, true) for e in every]))
            row += [percent(width), str(sum(holds(e, true) for e in every)) if np.isfinite(width) else "-"]
        rows.append(row)
    return "\n".join(TextTable(COUNTS, rows, left=(0, 1)).lines())


def main(arguments: Sequence[str] | None = None) -> list[Pair]:
    """The command line; returns the compared parameters."""
    parser = argparse.ArgumentParser(
        description="Section 4 of the paper as printed, and this project's estimates"
    )
    parser.add_argument("folder", type=Path, help="recordings of `harvester rig --machine lumped`")
    parser.add_argument("--seeds", type=int, default=0, help="repeat Figs. 6 to 8 with other noise")
    parser.add_argument(
        "--out", type=Path, default=Path("build/paper_section_4"), help="folder of the picture"
    )
    given = parser.parse_args(arguments)
    known, recordings = true_values(), read_folder(given.folder)
    pairs = list(compared(recordings, known))
    print(table(pairs))
    if given.seeds:
        print(
            f"\n{given.seeds} seeds of noise: mean error and half intervals [%], and how many hold the truth"
        )
        print(counted(list(repeated(given.seeds, known))))
    given.out.mkdir(parents=True, exist_ok=True)
    print(f"\nwrote {draw(pairs, recordings, known, given.out / 'section_4.png')}")
    return pairs


if __name__ == "__main__":
    try:
        main()
    except Problem as problem:
        sys.exit(str(problem))
