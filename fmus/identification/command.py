"""The command `harvester identify`: writes parameters.toml and a report from a folder of recordings."""

import os
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

from fmus.identification.machine import FREE
from fmus.identification.pipeline import Identified, identify
from fmus.identification.recordings.quality import prepared
from fmus.identification.recordings.reading import MACHINE, doubtful, read_folder, unused_files
from fmus.identification.report.identification_page import NAME, faults, page_content, report
from fmus.identification.report.prediction import prediction
from fmus.parameters import write
from orchestrator.base.errors import Problem
from orchestrator.base.progress import doing
from orchestrator.data.recording import Recording

DOUBTFUL, CONTRADICTED = 1, 3  # exit statuses: 2 is a mistake of the user


def run(folder: Path, out: Path, page: Path, *, joint: bool = True, names: Sequence[str] = FREE) -> int:
    """Read the recordings, identify, write parameters and report; prints the progress.

    Returns the exit status: 0 without a warning, `DOUBTFUL`, or `CONTRADICTED` if all warnings are findings.

    out    parameters.toml to write
    page   folder of identification.html and .json

    After an interrupt the parameters estimated until then are written, and KeyboardInterrupt is raised again.
    """
    if out.suffix != ".toml":
        raise Problem(f"--out {out}: expected a file that ends in .toml")
    start_time = perf_counter()
    recordings = read_folder(folder)
    suspect = doubtful(recordings)
    _print_size(folder, recordings, joint)
    recordings, qualities = map(list, zip(*map(prepared, recordings), strict=True))
    doubts = (f"warning: {sentence}" for sentence in suspect)
    for line in (*faults(qualities), *unused_files(folder, recordings), *doubts):
        print(f"  {line}")
    identified = identify(recordings, joint=joint, names=names, report=print, activity=doing)
    _write_parameters(out, identified)
    with doing("simulating what the model predicts, and the effects that it lacks"):
        comparison = prediction(identified)
        contents = page_content(folder, out, identified, comparison, qualities, os.cpu_count() or 1)
    contradicted = [_placed(f["procedure"], f["sentence"]) for f in contents["findings"] if f["named"]]
    status = DOUBTFUL if suspect or contents["warnings"] else CONTRADICTED if contradicted else 0
    contents["warnings"] = [*suspect, *contents["warnings"], *contradicted]
    found = report(contents)
    print(found.text())
    with doing("drawing the figures of the page"):
        html, data = found.write(page / f"{NAME}.html")
    print(f"report: {html}\nnumbers: {data}\n{perf_counter() - start_time:.0f} s")
    return status


def _placed(procedure: str, sentence: str) -> str:
    """A sentence that begins with the name of its procedure."""
    return sentence if sentence.startswith(procedure) else f"{procedure}: {sentence}"


def _print_size(folder: Path, recordings: Sequence[Recording], joint: bool) -> None:
    """The size of the task."""
    seconds = np.array([r.time[-1] - r.time[0] for r in recordings])
    work = np.array([r.procedure == MACHINE and r.use == "train" for r in recordings])
    print(f"{folder}: {len(recordings)} recordings, {seconds.sum():.0f} s")
    if joint and work.any():
        longer = "thrice that if the data show effects that the model lacks"
        print(f"  takes about {seconds[work].sum():.0f} s, {longer}")


def _write_parameters(out: Path, identified: Identified) -> None:
    """parameters.toml; after an interrupt raises KeyboardInterrupt."""
    parameters = {name: e.number() for name, (e, _) in sorted(identified.estimates.items())}
    out.parent.mkdir(parents=True, exist_ok=True)
    write(out, {"parameters": parameters | identified.listed})
    count = len(parameters)
    if identified.interrupted:
        print(f"{out}: {count} parameter{'s' * (count > 1)}, estimated until the interrupt; no report")
        raise KeyboardInterrupt
    curves = len({n.listed for n in identified.listed.values()}) // 2
    tables = f" and the opening curves of {curves} edges" if curves else ""
    print(f"{out}: {count} parameters with their 95 % intervals{tables}")
