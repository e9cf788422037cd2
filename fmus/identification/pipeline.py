"""From recordings to parameters: the paper's procedures in its order, then all parameters together.

What one procedure finds is known to the next. The result holds everything; nothing is written here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from types import ModuleType

from fmus.composition import declared
from fmus.identification import machine
from fmus.identification.estimate import Estimate
from fmus.identification.machine import Numbers, nominal, parameters, short_name, updated
from fmus.identification.procedure_result import ProcedureResult
from fmus.identification.procedures import (
    damping,
    hose_dynamics,
    hose_resistance,
    inertia,
    motor_leakage,
    valve,
)
from fmus.identification.refinement.gauss_newton import INTERRUPTED
from fmus.identification.refinement.multistart import SPREAD, MultistartResult, multistart
from fmus.identification.refinement.refine import RefinementResult, advice, refine
from fmus.machine.parts import SUBSYSTEMS
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

# in the paper's order: section 4 (a) to (e)
PROCEDURES: Mapping[str, ModuleType] = {
    "valve": valve,
    "hose_resistance": hose_resistance,
    "hose_dynamics": hose_dynamics,
    "motor_leakage": motor_leakage,
    "damping": damping,
}
MACHINE, INERTIA = "machine", "inertia"
OF_MACHINE = (MACHINE, "damping")  # procedures whose signals are those of the machine
# of [experiment], next to procedure and use: what a procedure reads, and what only tells how a test was done
CONDITIONS: Mapping[str, tuple[str, ...]] = {
    "valve": ("edge",),
    "hose_resistance": ("length", "diameter", "density"),
    "hose_dynamics": ("length", "diameter", "density"),
    "motor_leakage": ("shaft", "tank_pressure"),
    "damping": ("joint", "tank_pressure"),
    MACHINE: ("tank_pressure",),
}
ALSO: Mapping[str, tuple[str, ...]] = {"hose_dynamics": ("command",)}  # recorded by a bench, needed by nobody
# likeness from which a name is taken for a misspelling of another; names of the machine have much in common
ALIKE, ALIKE_ON_MACHINE = 0.8, 0.85

Report = Callable[[str], None]  # takes a line about what happens


@dataclass
class Identified:
    """What was identified so far.

    known         all numbers of the machine, estimates in the place of the files'
    findings      of the procedures that had recordings
    skipped       procedure -> why it gave nothing
    refined       the joint refinement, None without recordings of the whole machine
    starts        the same search from other start points, None if it was not asked for
    interrupted   would there have been more?
    """

    recordings: Sequence[Recording]
    known: dict[str, Number]
    findings: list[ProcedureResult] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    refined: RefinementResult | None = None
    starts: MultistartResult | None = None
    interrupted: bool = False

    @property
    def estimates(self) -> dict[str, tuple[Estimate, str]]:
        """Name -> estimate and its procedure; the joint refinement has the last word."""
        every = [(e, f.procedure) for f in self.findings for e in f.estimates]
        if self.refined is not None:
            every += [(e, MACHINE) for e in self.refined.estimates(names=parameters())]
        return {
            name: (replace(e, name=name), procedure)
            for e, procedure in every
            for name in [short_name(e.name, self.known)]
        }


def identify(
    recordings: Sequence[Recording],
    *,
    known: Numbers | None = None,
    joint: bool = True,
    inertial: bool = False,
    names: Sequence[str] = machine.FREE,
    starts: int = 0,
    report: Report = lambda _: None,
    show: Callable[[ProcedureResult], None] = lambda _: None,
) -> Identified:
    """Identify whatever the recordings allow.

    known      numbers to start from, `part.name`; by default those of the parameter files
    joint      refine together if there are recordings of the machine
    inertial   also estimate inertial parameters by themselves, which the paper took from CAD
    names      parameters of the joint refinement
    starts     from how many random points to search again: does the result depend on where it began?
    report     takes a line about what happens, `show` the result of each procedure
    """
    given = {r.procedure for r in recordings if r.use == "train"}
    unknown = sorted(given - {*PROCEDURES, MACHINE})
    if unknown:
        wanted = ", ".join((*PROCEDURES, MACHINE))
        raise Problem(f"[experiment] procedure is {unknown[0]!r}, expected one of {wanted}")
    machine.checked(names)
    for remark in remarks(recordings):
        report(remark)
    result = Identified(recordings, dict(known or nominal()))
    try:
        _run_procedures(result, given, inertial, report, show)
        if joint and MACHINE in given:
            _run_joint(result, names, starts, report)
    except KeyboardInterrupt:  # what was estimated until then is kept
        if not result.findings and result.refined is None:
            raise
        result.interrupted = True
    if not result.findings and result.refined is None:
        raise Problem(f"nothing was identified: {_no_result(given, joint)}")
    return result


def _no_result(given: set[str], joint: bool) -> str:
    """Why there is no result."""
    if not given:
        return 'all recordings are held out, expected one with use = "train"'
    if given == {MACHINE} and not joint:
        return "there are only recordings of the whole machine, which the joint refinement needs"
    return f"expected usable recordings of {', '.join(sorted(given))}"


def _run_procedures(
    result: Identified,
    given: Collection[str],
    inertial: bool,
    report: Report,
    show: Callable[[ProcedureResult], None],
) -> None:
    """The paper's procedures in its order; what one cannot estimate does not hinder the others."""
    for name, procedure in {**PROCEDURES, **({INERTIA: inertia} if inertial else {})}.items():
        if name not in given and not (name == INERTIA and {"damping", MACHINE} & set(given)):
            result.skipped[name] = "no recording"
            continue
        try:
            finding = procedure.identify(result.recordings, result.known)
        except Problem as error:
            result.skipped[name] = str(error)
            report(f"{name}: {error}")
            continue
        result.findings.append(finding)
        result.known = updated(result.known, finding.estimates)
        show(finding)


def _run_joint(result: Identified, names: Sequence[str], starts: int, report: Report) -> None:
    """The joint refinement, and from other starts."""
    own = [r for r in result.recordings if r.procedure == MACHINE]
    try:
        result.refined = refine_together(own, result.known, names, report)
    except Problem as error:
        if not result.findings:
            raise
        result.skipped[MACHINE] = str(error)
        report(f"{MACHINE}: {error}")
        return
    result.known = updated(result.known, result.refined.estimates(names=parameters()))
    result.interrupted = result.refined.reason == INTERRUPTED
    if starts and not result.interrupted:
        result.starts = refine_from_other_starts(result.refined, starts, report)
        result.interrupted = result.starts.interrupted


def refine_together(
    recordings: Sequence[Recording], known: Numbers, names: Sequence[str], report: Report
) -> RefinementResult:
    """All parameters against all recordings of the machine."""
    task = machine.problem(recordings, known, names)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in task.training)
    report(f"joint refinement: {len(task.free)} parameters, {len(task.outputs)} signals, {seconds:.0f} s;")
    for line in machine.assumptions(recordings):
        report(f"  {line}")
    report("  predictions over half a second first, then whole recordings, then their weights")
    refined = refine(
        task,
        progress=lambda p: report(f"  iteration {p.iteration}: {p.remaining:.2g} standard deviations to go"),
    )
    size = refined.history[-1].residual if refined.history else float("nan")
    report(f"  {refined.reason}; residuals are {size:.3g} times what the sensors explain")
    for line in advice(refined):
        report(f"  {line}")
    return refined


def refine_from_other_starts(refined: RefinementResult, count: int, report: Report) -> MultistartResult:
    """The same search from random starts."""
    result = multistart(refined, count=count)
    if result.starts:
        reached = round(result.fraction * len(result.starts))
        report(
            f"random starts, up to {100 * SPREAD:.0f} % away or twice the standard deviation known before: "
            f"{reached} of {len(result.starts)} lead to the same result, on every fourth sample"
        )
    return result


def remarks(recordings: Sequence[Recording]) -> list[str]:
    """Sentences on signals that nobody reads; a name that is nearly one that is read is refused.

    A misspelt name would be left out without a word otherwise.
    """
    for recording in recordings:
        _check_conditions(recording)
    return [text for recording in recordings for text in _unused_signals(recording)]


def _unused_signals(recording: Recording) -> Iterator[str]:
    """The machine's signals are refused if they come close to another, a bench's are only named."""
    procedure, of_machine = recording.procedure, recording.procedure in OF_MACHINE
    if of_machine:
        own = {*declared(SUBSYSTEMS, "inputs"), *declared(SUBSYSTEMS, "outputs")}
    elif procedure in PROCEDURES:
        own = {*PROCEDURES[procedure].SIGNALS, *ALSO.get(procedure, ())}
    else:
        return
    unused = []
    for name in recording.signals:
        if name in own:
            continue
        near = _near(name, own, ALIKE_ON_MACHINE) if of_machine else ""
        if near:
            raise Problem(
                f"{recording.source}: signal {name} is no input or output of the machine, expected {near}"
            )
        missing = _near(name, own - set(recording.signals), ALIKE)
        unused.append(f"{name} (misspelt {missing}?)" if missing else name)
    if unused:
        what = "the machine" if of_machine else procedure
        yield f"{recording.source.name}: no signal of {what}, not used: {', '.join(unused)}"


def _check_conditions(recording: Recording) -> None:
    """A key that is nearly one that counts is refused; any other may be a note."""
    own = CONDITIONS.get(recording.procedure, ())
    anywhere = {name for names in CONDITIONS.values() for name in names}
    for name in recording.conditions:
        near = "" if name in anywhere else _near(name, own, ALIKE)
        if near:
            raise Problem(f"{recording.source}: [experiment] unknown key {name}, expected {near}")


def _near(name: str, known: Collection[str], alike: float) -> str:
    """The known name that this one may be meant for, in whatever case and with or without its part."""
    ends: dict[str, list[str]] = {}
    for own in sorted(known):
        ends.setdefault(own.lower().rpartition(".")[2], []).append(own)
    close = get_close_matches(name.lower().rpartition(".")[2], ends, 1, alike)
    # of equal ends that of the part which was written
    return get_close_matches(name.lower(), ends[close[0]], 1, 0.0)[0] if close else ""
