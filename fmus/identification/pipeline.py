"""Identification pipeline: the paper's procedures in its order, then a refinement of all parameters together.

Each procedure uses the estimates of those before it. `identify` writes no file; `run` is the command
`harvester identify`, which writes parameters.toml and a report from a folder of recordings.
"""

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import NoReturn

from fmus.composition import declared
from fmus.identification import machine
from fmus.identification.machine import Parameters, nominal, short_name, updated
from fmus.identification.procedures import rest
from fmus.identification.procedures.damping import DAMPING
from fmus.identification.procedures.hoses import HOSE_DYNAMICS, HOSE_RESISTANCE
from fmus.identification.procedures.motor_leakage import MOTOR_LEAKAGE
from fmus.identification.procedures.procedure import Computed, Procedure
from fmus.identification.procedures.seal_leakage import SEAL_LEAKAGE
from fmus.identification.procedures.valve import VALVE
from fmus.identification.procedures.weighing import WEIGHING
from fmus.identification.recordings import reading
from fmus.identification.recordings.quality import hum, prepared
from fmus.identification.recordings.reading import CONDITIONS, MACHINE, MACHINE_SIGNALS, REST, TEMPERATURE
from fmus.identification.refinement.refine import RefinementResult, advice, compiled, refine
from fmus.identification.refinement.shooting import INTERRUPTED
from fmus.identification.results import NO_RECORDING, Estimate, Finding, ProcedureResult, least
from fmus.machine.parts import FERIC
from fmus.parameters import Number, write
from orchestrator.base.errors import Problem, suggest
from orchestrator.base.progress import doing
from orchestrator.base.text import display_unit, first_names
from orchestrator.data.recording import Recording

# zeros of sensors first, then the paper's order: section 4 (a) to (e); the paper has no others
_BENCHES = rest.REST, VALVE, HOSE_RESISTANCE, HOSE_DYNAMICS, MOTOR_LEAKAGE, SEAL_LEAKAGE
PROCEDURES: Mapping[str, Procedure | Computed] = {p.name: p for p in (*_BENCHES, DAMPING, WEIGHING)}
GROUPS = ("inputs", "outputs")  # of the machine's variables that can be recorded
UNREAD: Mapping[str, tuple[str, ...]] = {"hose_dynamics": ("command",)}  # usual signals that are not needed
FEW = 20  # names that are listed in a message
DEAD_BAND = "valve_dead_band"

Report = Callable[[str], None]  # prints lines about the progress
Activity = Callable[[str], AbstractContextManager[object]]  # shows what is done inside its block


@dataclass
class Identified:
    """Results of an identification, complete or until an interrupt.

    recordings    those of the machine without the zeros and delays that the joint refinement estimated
    parameters    all parameters of the machine, with the estimates in place of the values in files
    results       of the procedures that had recordings
    skipped       procedure -> reason why it has no result
    refined       the joint refinement, None without recordings of the machine
    interrupted   whether an interrupt ended the identification early
    """

    recordings: Sequence[Recording]
    parameters: dict[str, Number]
    results: list[ProcedureResult] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    refined: RefinementResult | None = None
    interrupted: bool = False

    def __repr__(self) -> str:
        found = [f"{name} {e.value:.4g} {e.unit}" for name, (e, _) in self.estimates.items()]
        counts = f"{len(found)} parameters from {len(self.recordings)} recordings"
        return f"Identified: {counts}{', interrupted' * self.interrupted}\n{first_names(found, 8)}"

    @property
    def estimates(self) -> dict[str, tuple[Estimate, str]]:
        """Name -> estimate and its procedure; the joint refinement replaces estimates of procedures."""
        estimates = [(e, result.procedure) for result in self.results for e in result.estimates]
        if self.refined is not None:
            estimates += [(e, MACHINE) for e in machine.estimates(self.refined)]
        return {
            name: (replace(e, name=name), procedure)
            for e, procedure in estimates
            for name in [short_name(e.name, self.parameters)]
        }

    @property
    def listed(self) -> dict[str, Number]:
        """Name -> entry of a list of parameters.toml: points of the opening curves, in their order."""
        return {e.name: e.number() for result in self.results for e in result.listed}

    @property
    def findings(self) -> list[tuple[str, Finding]]:
        """The tests of all assumptions: procedure and finding, in the order of the procedures."""
        tests = [(r.procedure, finding) for r in self.results for finding in r.findings]
        tests += hum_findings(self.recordings)
        return tests + [(MACHINE, f) for f in (machine.findings(self.refined) if self.refined else ())]

    def of_machine(self, use: str) -> list[Recording]:
        """The recordings of the machine at work to "train" or to "test"."""
        return [r for r in self.recordings if r.procedure == MACHINE and r.use == use]

    def skip(self, procedure: str, error: Problem, report: Report) -> None:
        """Note and report why a procedure has no result."""
        self.skipped[procedure] = str(error).removeprefix(f"{procedure}: ")
        report(f"{procedure}: {self.skipped[procedure]}")


def identify(
    recordings: Sequence[Recording],
    *,
    parameters: Parameters | None = None,
    joint: bool = True,
    names: Sequence[str] = machine.FREE,
    report: Report = lambda _: None,
    activity: Activity = lambda _: nullcontext(),
) -> Identified:
    """Estimate all parameters that the recordings determine.

    parameters   known values, `part.name`; by default those of the parameter files
    joint        refine all parameters together if there are recordings of the machine
    names        parameters of the joint refinement
    report       called with lines about the progress and the result of each procedure
    activity     context manager around what takes long, called with a text
    """
    procedures = {r.procedure for r in recordings if r.use == "train"}
    unknown = sorted(procedures - {*PROCEDURES, MACHINE})
    if unknown:
        expected = ", ".join((*PROCEDURES, MACHINE))
        raise Problem(f"[experiment] procedure: expected one of {expected}, got {unknown[0]!r}")
    machine.check_free(names)
    signals = {name: procedure.signals for name, procedure in PROCEDURES.items()}
    check_names([r for r in recordings if r.procedure in (*PROCEDURES, MACHINE)], signals)
    stated = [machine.with_return_line(r) if r.procedure == MACHINE else r for r in recordings]
    identified = Identified(stated, dict(parameters or nominal()))
    try:
        _run_procedures(identified, procedures, report, activity)
        if joint and MACHINE in procedures:
            _run_joint(identified, names, report, activity)
    except KeyboardInterrupt:  # estimates until the interrupt are kept
        if not identified.results and identified.refined is None:
            raise
        identified.interrupted = True
    if not identified.results and identified.refined is None:
        raise Problem(f"nothing was identified: {_no_result(procedures, joint)}")
    return identified


def _no_result(procedures: set[str], joint: bool) -> str:
    """The reason why there is no result."""
    if not procedures:
        return 'expected a recording with use = "train", got held-out recordings only'
    if procedures == {MACHINE} and not joint:
        return "--no-joint: all recordings are of the whole machine, and only the joint refinement uses these"
    return f"expected usable recordings of {', '.join(sorted(procedures))}"


def _run_procedures(
    identified: Identified, recorded: Collection[str], report: Report, activity: Activity
) -> None:
    """The paper's procedures in its order; a procedure that fails does not stop the others."""
    for name, procedure in PROCEDURES.items():
        if name not in recorded:
            identified.skipped[name] = NO_RECORDING
            continue
        try:
            with activity(f"procedure {name}"):
                result = procedure.identify(identified.recordings, identified.parameters)
        except Problem as error:
            identified.skip(name, error, report)
            continue
        identified.results.append(result)
        if procedure is rest.REST:
            identified.recordings = rest.subtracted(identified.recordings, result)
        identified.parameters = updated(identified.parameters, (*result.estimates, *result.listed))
        report(str(result))


def _run_joint(identified: Identified, names: Sequence[str], report: Report, activity: Activity) -> None:
    """The joint refinement."""
    recordings = [r for r in identified.recordings if r.procedure == MACHINE]
    second = [  # points of the openings of all edges, 0 of those without a table
        number.value
        for name, number in identified.parameters.items()
        if name.partition(".")[2].startswith("valve_") and name.endswith("_command_2")
    ]
    if DEAD_BAND in names and second and all(value > 0 for value in second):
        report(f"{DEAD_BAND}: not refined, because tables replace it; they stay as they are")
        names = [name for name in names if name != DEAD_BAND]
    try:
        refined = refine_together(recordings, identified.parameters, names, report, activity)
    except Problem as error:
        if not identified.results:
            raise
        identified.skip(MACHINE, error, report)
        return
    identified.refined = refined
    identified.parameters = updated(identified.parameters, machine.estimates(refined))
    identified.recordings = machine.corrected(identified.recordings, refined)
    identified.interrupted = refined.reason == INTERRUPTED


def hum_findings(recordings: Iterable[Recording]) -> Iterator[tuple[str, Finding]]:
    """A test of each signal but commands with a periodic disturbance large enough: procedure and finding."""
    found: dict[tuple[str, str], list[Finding]] = {}
    for r in recordings:
        for name in (n for n in r.signals if not n.endswith("command")):
            p, frequency, rms = hum(r, name)
            size = f"{frequency:.3g} Hz, {display_unit(r.units[name]).ascii(rms)} rms"
            sentence = f"{r.source.name}: {name} has a periodic disturbance of {size}: a hum of the mains?"
            sentence += " The intervals take it for noise of independent samples"
            if p < 1.0:
                finding = Finding("periodic disturbance", p, sentence)
                found.setdefault((r.procedure, name), []).append(finding)
    return ((procedure, least(tests)) for (procedure, _), tests in found.items())


def refine_together(
    recordings: Sequence[Recording],
    parameters: Parameters,
    names: Sequence[str],
    report: Report,
    activity: Activity,
) -> RefinementResult:
    """Output-error estimate of all parameters from all recordings of the machine."""
    with activity("compiling the model for the joint refinement"):
        problem = machine.problem(recordings, parameters, names)
        simulator = compiled(problem)
    size = f"{len(problem.free)} parameters, {len(problem.outputs)} signals, {problem.seconds:.0f} s"
    report(f"joint refinement: {size}")
    for line in machine.assumptions(recordings):
        report(f"  {line}")
    report("  predictions over half a second first, then whole recordings, then their weights")
    refined = refine(
        problem,
        simulator,
        progress=lambda p: report(f"  iteration {p.iteration}: {p.remaining:.2g} standard deviations to go"),
    )
    residual = refined.history[-1].residual if refined.history else float("nan")
    report(f"  {refined.reason}; residuals are {residual:.3g} times the noise of the sensors")
    for line in (*machine.sensor_sentences(refined), *advice(refined)):
        report(f"  {line}")
    return refined


# ---- names that no procedure reads are refused: a misspelt one would be ignored silently -----------------


def check_names(recordings: Iterable[Recording], signals: Mapping[str, Mapping[str, str]]) -> None:
    """Raise Problem if a recording has a signal or a condition that its procedure does not read.

    Also if it gives a signal in a unit of another dimension.

    signals   procedure of a test bench -> the signals that it reads, with their SI units
    """
    of_machine = {n: q.unit for group in GROUPS for n, q in declared(FERIC.subsystems, group).items()}
    of_driving = {name for names in FERIC.inputs.values() for name in names}
    for recording in recordings:
        procedure, source, conditions = recording.procedure, recording.source, CONDITIONS[recording.procedure]
        for name in (n for n in recording.conditions if n not in (*conditions, reading.NOTE)):
            _refuse(f"{source}: [experiment] {name}", procedure, name, conditions, reading.NOTE)
        known = of_machine if procedure in MACHINE_SIGNALS else signals[procedure]
        read = {*known, *UNREAD.get(procedure, ()), TEMPERATURE}
        for name in recording.signals:
            if recording.sensor(name).delay_error and (procedure != MACHINE or name not in of_driving):
                only = "only that of a command or line pressure of the machine at work can be estimated"
                raise Problem(f"{source}: signal {name}: delay_error: {only}; `delay` states a known one")
            if procedure != REST and name not in read:  # at rest any sensor
                _refuse(f"{source}: signal {name}", procedure, name, known, TEMPERATURE)
        reading.require(recording, {name: unit for name, unit in known.items() if name in recording.signals})


def _refuse(place: str, procedure: str, name: str, read: Collection[str], other: str) -> NoReturn:
    """A message with the names that are read, if they are few."""
    listed = ", ".join(sorted(read)) if len(read) < FEW else "inputs and outputs of the machine"
    similar = suggest(name.lower(), read)
    raise Problem(f"{place}: {procedure} does not read it; it reads {listed} and {other}{similar}")


# ---- the command -----------------------------------------------------------------------------------------

DOUBTFUL, CONTRADICTED = 1, 3  # exit statuses: 2 is a mistake of the user


def run(
    folder: Path,
    out: Path,
    page: Path,
    *,
    joint: bool = True,
    names: Sequence[str] = machine.FREE,
    report: Report = print,
) -> int:
    """Read the recordings, identify, write parameters and report.

    Returns the exit status: 0 without a warning, `DOUBTFUL`, or `CONTRADICTED` if all warnings are findings.

    out      parameters.toml to write
    page     folder of identification.html and .json
    report   takes lines of text: progress, warnings and results

    After an interrupt the parameters estimated until then are written, and KeyboardInterrupt is raised again.
    """
    # these modules import this one
    from fmus.identification.report.identification_page import NAME, faults, page_content
    from fmus.identification.report.identification_page import report as page_report
    from fmus.identification.report.prediction import prediction

    if out.suffix != ".toml":
        raise Problem(f"--out {out}: expected a file that ends in .toml")
    start_time = perf_counter()
    recordings = reading.read_folder(folder)
    suspect = reading.doubtful(recordings)
    report(f"{folder}: {len(recordings)} recordings, {sum(map(_seconds, recordings)):.0f} s")
    if work := [_seconds(r) for r in recordings if r.procedure == MACHINE and r.use == "train" and joint]:
        longer = "thrice that if the data show effects that the model lacks"
        report(f"  takes about {sum(work):.0f} s, {longer}")
    recordings, qualities = map(list, zip(*map(prepared, recordings), strict=True))
    doubts = (f"warning: {sentence}" for sentence in suspect)
    for line in (*faults(qualities), *reading.unused_files(folder, recordings), *doubts):
        report(f"  {line}")
    identified = identify(recordings, joint=joint, names=names, report=report, activity=doing)
    report(_written(out, identified))
    if identified.interrupted:
        raise KeyboardInterrupt
    with doing("simulating what the model predicts, and the effects that it lacks"):
        comparison = prediction(identified)
        contents = page_content(folder, out, identified, comparison, qualities, os.cpu_count() or 1)
    contradicted = [
        f["sentence"] if f["sentence"].startswith(f["procedure"]) else f"{f['procedure']}: {f['sentence']}"
        for f in contents["findings"]
        if f["named"]
    ]
    status = DOUBTFUL if suspect or contents["warnings"] else CONTRADICTED if contradicted else 0
    contents["warnings"] = [*suspect, *contents["warnings"], *contradicted]
    found = page_report(contents)
    report(found.text())
    with doing("drawing the figures of the page"):
        html, data = found.write(page / f"{NAME}.html")
    report(f"report: {html}\nnumbers: {data}\n{perf_counter() - start_time:.0f} s")
    return status


def _seconds(recording: Recording) -> float:
    """Length of a recording [s]."""
    return float(recording.time[-1] - recording.time[0])


def _written(out: Path, identified: Identified) -> str:
    """Write parameters.toml; returns a line about it."""
    parameters = {name: e.number() for name, (e, _) in sorted(identified.estimates.items())}
    out.parent.mkdir(parents=True, exist_ok=True)
    write(out, {"parameters": parameters | identified.listed})
    count = len(parameters)
    if identified.interrupted:
        return f"{out}: {count} parameter{'s' * (count > 1)}, estimated until the interrupt; no report"
    curves = len({n.listed for n in identified.listed.values()}) // 2
    tables = f" and the opening curves of {curves} edges" if curves else ""
    return f"{out}: {count} parameters with their 95 % intervals{tables}"
