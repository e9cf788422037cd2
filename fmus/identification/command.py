"""The command `harvester identify`: writes parameters.toml and a report from a folder of recordings."""

import os
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

from fmus.identification.machine import FREE
from fmus.identification.outcome import (
    extrapolated,
    extrapolation_text,
    page_content,
    prediction,
    worst_signals,
)
from fmus.identification.pipeline import identify
from fmus.identification.procedure_result import ProcedureResult
from fmus.identification.recording_names import MACHINE
from fmus.identification.recordings.clock import downsample, resample_uniformly
from fmus.identification.recordings.reading import doubtful, read_folder, unused_files
from fmus.identification.report import report_texts
from fmus.identification.report.identification_page import faults, quality, write_page
from fmus.parameters import write
from orchestrator.base.errors import Problem
from orchestrator.base.progress import doing
from orchestrator.base.units import display_conversion

DOUBTFUL, CONTRADICTED = 1, 3  # exit statuses: 2 is a mistake of the user


def run(
    folder: Path,
    out: Path,
    page: Path,
    *,
    joint: bool = True,
    inertial: bool = False,
    names: Sequence[str] = FREE,
    starts: int = 0,
) -> int:
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
    qualities = [quality(r) for r in recordings]
    seconds = sum(float(r.time[-1] - r.time[0]) for r in recordings)
    print(f"{folder}: {len(recordings)} recordings, {seconds:.0f} s")
    work = [r for r in recordings if r.procedure == MACHINE and r.use == "train"]
    if joint and work:
        fitted = sum(float(r.time[-1] - r.time[0]) for r in work)
        print(f"  takes about {fitted:.0f} s, thrice that if the data show effects that the model lacks")
    suspect = doubtful(recordings)
    told = (f"warning: {line}" for line in suspect)
    for line in (*faults(qualities), *unused_files(folder, recordings), *told):
        print(f"  {line}")
    recordings = [resample_uniformly(r) for r in recordings]
    recordings = [downsample(r) if r.procedure == MACHINE else r for r in recordings]
    identified = identify(
        recordings,
        joint=joint,
        inertial=inertial,
        names=names,
        starts=starts,
        report=print,
        show=_show,
        activity=doing,
    )
    parameters = {name: e.number() for name, (e, _) in sorted(identified.estimates.items())}
    count = len(parameters)
    parameters |= identified.listed
    out.parent.mkdir(parents=True, exist_ok=True)
    write(out, {"parameters": parameters})
    if identified.interrupted:
        plural = "s" * (count > 1)
        print(f"{out}: {count} parameter{plural}, estimated until the interrupt; no report")
        raise KeyboardInterrupt
    curves = len({n.listed for n in identified.listed.values()}) // 2
    tables = f" and the opening curves of {curves} edges" if curves else ""
    print(f"{out}: {count} parameters with their 95 % intervals{tables}")
    with doing("simulating what the model predicts, and the effects that it lacks"):
        comparison = prediction(identified)
        contents = page_content(folder, out, identified, comparison, qualities, os.cpu_count() or 1)
    if comparison:
        use = "held out" if comparison.recording.use == "test" else "used for fitting"
        print(f"predicted: {comparison.recording.source.name}, {use}; NRMSE of the worst signals")
        for quantity, (name, error) in worst_signals(comparison).items():
            print(f"  {quantity:<10}{100 * error:5.2f} %  {name}")
        if held := comparison.held():
            least = min(held, key=lambda name: held[name])
            mean = sum(held.values()) / len(held)
            print(f"  95 % bands hold {100 * mean:.0f} %, of {least} {100 * held[least]:.0f} %")
    if contents["explanation"]:
        print(contents["explanation"].verdict)
    for outside in extrapolated(identified):
        print(f"warning: {extrapolation_text(outside)}")
    contradicted = [f"{f['procedure']}: {f['sentence']}" for f in contents["findings"] if f["named"]]
    for line in (*contents["warnings"], *contradicted):
        print(f"warning: {line}")
    status = DOUBTFUL if suspect or contents["warnings"] else CONTRADICTED if contradicted else 0
    contents["warnings"] = [*suspect, *contents["warnings"], *contradicted]
    with doing("drawing the figures of the page"):
        html, data = write_page(page, contents)
    print(f"report: {html}\nnumbers: {data}\n{perf_counter() - start_time:.0f} s")
    return status


def _show(result: ProcedureResult) -> None:
    """Print the estimates of a procedure in display units, in ASCII for any terminal."""
    print(f"{result.procedure}:")
    for e in result.estimates or result.others:  # of a procedure without parameters, such as a weighing
        unit, factor = display_conversion(e.unit) or (e.unit, 1.0)
        value, low, high = (f"{factor * x:.{report_texts.digits(e)}g}" for x in (e.value, e.low, e.high))
        print(f"  {e.name:<38}{value:>12}  ({low} to {high}) {unit}")
