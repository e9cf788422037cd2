"""The command `harvester identify`: a folder of recordings becomes parameters.toml and a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

from fmus.contract import ModelError, quantities
from fmus.identification.finding import Estimate
from fmus.identification.known import Known, lookup, nominal
from fmus.identification.machine import FREE
from fmus.identification.pipeline import MACHINE, Identified, identify
from fmus.identification.recordings.reading import read_folder
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.names import parameters, signals
from fmus.identification.report.attribution import Explanation
from fmus.identification.report.compared import Compared, attribute, picture, predicted
from fmus.identification.report.content import Page, Parameter, Picture, Quality
from fmus.identification.report.data import quality
from fmus.identification.report.page import write_page
from fmus.identification.report.refined import refinement
from fmus.machine import SUBSYSTEMS
from fmus.parameters import write

PICTURED = ("swing", "stick", "boom")  # joints: Figs. 10 and 11 of the paper, and the third


def run(
    folder: Path,
    out: Path,
    page: Path,
    *,
    joint: bool = True,
    inertial: bool = False,
    names: Sequence[str] = FREE,
) -> None:
    """Read, identify, write the parameters and the page; prints what happens.

    out    parameters.toml to write
    page   folder of identification.html and .json
    """
    if out.suffix != ".toml":
        raise ModelError(f"--out {out}: expected a file that ends in .toml")
    begun = perf_counter()
    recordings = read_folder(folder)
    qualities = [quality(r) for r in recordings]
    seconds = sum(float(r.time[-1] - r.time[0]) for r in recordings)
    print(f"{folder}: {len(recordings)} recordings, {seconds:.0f} s")
    for q in qualities:
        for remark in (*q.remarks, *(f"{c.signal}: {told}" for c in q.channels for told in c.remarks)):
            print(f"  {q.name}: {remark}")
    found = identify(recordings, joint=joint, inertial=inertial, names=names, tell=print)
    tables = {"parameters": {name: e.number() for name, (e, _) in sorted(found.estimates.items())}}
    out.parent.mkdir(parents=True, exist_ok=True)
    write(out, tables)
    print(f"{out}: {len(tables['parameters'])} parameters with their 95 % intervals")
    html, data = write_page(page, content(folder, out, found, qualities))
    print(f"report: {html}\nnumbers: {data}\n{perf_counter() - begun:.0f} s")


def content(folder: Path, out: Path, found: Identified, qualities: Sequence[Quality] = ()) -> Page:
    """Everything that the page shows; predicts the recordings of the machine with the numbers found."""
    seen = [predicted(r, _numbers(found.known)) for r in found.recordings if r.procedure == MACHINE]
    held_out = next((s for s in seen if s.recording.use == "test"), None)
    shown = held_out or (seen[0] if seen else None)
    return Page(
        title=f"Identification from {folder.name}",
        source=str(folder),
        kinds=tuple(dict.fromkeys(r.kind for r in found.recordings)),
        findings=found.findings,
        parameters=tuple(_parameter(e, procedure) for e, procedure in found.estimates.values()),
        qualities=tuple(qualities),
        refinement=refinement(found.refined, parameters(), signals()) if found.refined else None,
        explanation=_explanation(shown, found) if shown else None,
        pictures=tuple(_pictures(shown)) if shown else (),
        commands=_commands(folder, out, found.recordings),
        remarks=tuple(f"{name}: {why}." for name, why in found.skipped.items()),
    )


def _numbers(known: Known) -> dict[str, float]:
    """Of the usual parts only: a variant keeps its own."""
    own = {f"{part}.{name}" for part, sub in SUBSYSTEMS.items() for name in quantities(sub.parameters)}
    return {name: number.value for name, number in known.items() if name in own}


def _parameter(estimate: Estimate, procedure: str) -> Parameter:
    before = lookup(estimate.name, nominal())
    name = estimate.name.rpartition(".")[2]
    text = next(q[name].text for s in SUBSYSTEMS.values() if name in (q := quantities(s.parameters)))
    return Parameter(estimate, procedure, before.value, before.source, text)


def _explanation(seen: Compared, found: Identified) -> Explanation | None:
    if found.refined is None:
        return None
    fitted = [name for name, (_, procedure) in found.estimates.items() if procedure == MACHINE]
    return attribute(seen, _numbers(found.known), fitted)


def _pictures(seen: Compared) -> list[Picture]:
    moved = [j for j in PICTURED if np.ptp(seen.predicted[f"manipulator.{j}_angle"]) > 0.01]
    return [picture(seen, joint) for joint in moved]


def _commands(folder: Path, out: Path, recordings: Sequence[Recording]) -> dict[str, str]:
    """How to go on."""
    told = {f"harvester build --parameters {out}": "FMUs with these numbers"}
    held_out = [r for r in recordings if r.procedure == MACHINE and r.use == "test"]
    for recording in held_out[:1]:
        command = f"harvester validate --reference {folder / recording.source.name}"
        told[command] = "their run against the recording that was held out"
    return told
