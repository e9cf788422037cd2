"""The steps of the pipeline: the paper's procedures, then all parameters together.

The joint refinement as a step on the way: what is told while it runs, and of its result.

Is what recordings tell what somebody reads? A misspelt name would be left out without a word.

From recordings to parameters: the paper's procedures in its order, then all together.

What one procedure finds is known to the next. The result holds everything; nothing is written here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from types import ModuleType

from fmus.composition import declared
from fmus.identification import machine
from fmus.identification.known import Estimate, Finding, Known, nominal, plain, updated
from fmus.identification.procedures import (
    damping,
    hose_dynamics,
    hose_resistance,
    inertia,
    motor_leakage,
    valve,
)
from fmus.identification.refinement.gauss_newton import INTERRUPTED
from fmus.identification.refinement.problem import parameters
from fmus.identification.refinement.random_starts import SPREAD, Starts, from_random_starts
from fmus.identification.refinement.refine import refine
from fmus.identification.refinement.result import Refined, advice
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
Tell = Callable[[str], None]


@dataclass
class Steps:
    """What was found so far; each step takes what those before it found."""

    recordings: Sequence[Recording]
    numbers: dict[str, Number]
    tell: Tell
    show: Callable[[Finding], None]
    findings: list[Finding] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    refined: Refined | None = None
    starts: Starts | None = None

    def procedures(self, given: Collection[str], inertial: bool) -> None:
        """The paper's procedures in its order."""
        for name, procedure in {**PROCEDURES, **({INERTIA: inertia} if inertial else {})}.items():
            if name not in given and not (name == INERTIA and {"damping", MACHINE} & set(given)):
                self.skipped[name] = "no recording"
                continue
            try:
                finding = procedure.identify(self.recordings, self.numbers)
            except Problem as error:
                self._skip(name, error)
                continue
            self.findings.append(finding)
            self.numbers = updated(self.numbers, finding.estimates)
            self.show(finding)

    def together(self, names: Sequence[str], starts: int) -> bool:
        """The joint refinement, and from other starts; was it done to the end?"""
        own = [r for r in self.recordings if r.procedure == MACHINE]
        try:
            self.refined = together(own, self.numbers, names, self.tell)
        except Problem as error:
            if not self.findings:
                raise
            self._skip(MACHINE, error)
            return True
        self.numbers = updated(self.numbers, self.refined.estimates(names=parameters()))
        if self.refined.reason == INTERRUPTED:
            return False
        if starts:
            self.starts = again(self.refined, starts, self.tell)
        return self.starts is None or not self.starts.interrupted

    def _skip(self, name: str, error: Problem) -> None:
        """The others can still be found."""
        self.skipped[name] = str(error)
        self.tell(f"{name}: {error}")


def together(recordings: Sequence[Recording], known: Known, names: Sequence[str], tell: Tell) -> Refined:
    """All parameters against all recordings of the machine."""
    task = machine.problem(recordings, known, names)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in task.training)
    tell(f"joint refinement: {len(task.free)} parameters, {len(task.outputs)} signals, {seconds:.0f} s;")
    for line in machine.assumed(recordings):
        tell(f"  {line}")
    tell("  predictions over half a second first, then whole recordings, then their weights")
    found = refine(
        task,
        progress=lambda p: tell(f"  iteration {p.iteration}: {p.predicted:.2g} standard deviations to go"),
    )
    size = found.history[-1].residual if found.history else float("nan")
    tell(f"  {found.reason}; residuals are {size:.3g} times what the sensors explain")
    for line in advice(found):
        tell(f"  {line}")
    return found


def again(refined: Refined, count: int, tell: Tell) -> Starts:
    """The same search from random starts."""
    found = from_random_starts(refined, count=count)
    if not found.starts:
        return found
    reached = round(found.share * len(found.starts))
    tell(
        f"random starts, up to {100 * SPREAD:.0f} % away or twice the standard deviation known before: "
        f"{reached} of {len(found.starts)} lead to the same result, on every fourth sample"
    )
    return found


OF_MACHINE = (MACHINE, "damping")  # procedures whose signals are those of the machine
# of [experiment], beside procedure and use: what a procedure reads, and what only tells how a test was done
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


def remarks(recordings: Sequence[Recording]) -> list[str]:
    """Sentences on what is not read; a name that is nearly one that is read is refused."""
    for recording in recordings:
        _check_conditions(recording)
    return [text for recording in recordings for text in _signals(recording)]


def _signals(recording: Recording) -> Iterator[str]:
    """The machine's signals are refused if they come close to another, a bench's are only named."""
    if recording.procedure not in PROCEDURES and recording.procedure != MACHINE:
        return
    of_machine = recording.procedure in OF_MACHINE
    known = _of_machine() if of_machine else _of_bench(recording.procedure)
    unknown = [name for name in recording.signals if name not in known]
    for name in unknown if of_machine else ():
        near = _near(name, known, ALIKE_ON_MACHINE)
        if near:
            raise Problem(
                f"{recording.source}: signal {name} is no input or output of the machine, expected {near}"
            )
    if unknown:
        what = "the machine" if of_machine else recording.procedure
        names = [f"{name}{_meant(name, known, recording)}" for name in unknown]
        yield f"{recording.source.name}: no signal of {what}, not used: {', '.join(names)}"


def _check_conditions(recording: Recording) -> None:
    """A key that is nearly one that counts is refused; any other may be a note."""
    known = CONDITIONS.get(recording.procedure, ())
    anywhere = {name for names in CONDITIONS.values() for name in names}
    for name in recording.conditions:
        near = "" if name in anywhere else _near(name, known, ALIKE)
        if near:
            raise Problem(f"{recording.source}: [experiment] unknown key {name}, expected {near}")


def _of_machine() -> set[str]:
    return {*declared(SUBSYSTEMS, "inputs"), *declared(SUBSYSTEMS, "outputs")}


def _of_bench(procedure: str) -> set[str]:
    return {*PROCEDURES[procedure].SIGNALS, *ALSO.get(procedure, ())}


def _near(name: str, known: Collection[str], alike: float) -> str:
    """The known name that this one may be meant for, in whatever case and with or without its part."""
    ends: dict[str, list[str]] = {}
    for own in sorted(known):
        ends.setdefault(_end(own), []).append(own)
    close = get_close_matches(_end(name), ends, 1, alike)
    # of equal ends that of the part which was written
    return get_close_matches(name.lower(), ends[close[0]], 1, 0.0)[0] if close else ""


def _end(name: str) -> str:
    return name.lower().rpartition(".")[2]


def _meant(name: str, known: Collection[str], recording: Recording) -> str:
    """The name that is missing, if this one comes close to it."""
    near = _near(name, [own for own in known if own not in recording.signals], ALIKE)
    return f" (misspelt {near}?)" if near else ""


__all__ = ["MACHINE", "PROCEDURES", "Identified", "identify"]


@dataclass(frozen=True)
class Identified:
    """What was found.

    findings      of the procedures that had recordings
    skipped       procedure -> why it found nothing
    refined       the joint refinement, None without recordings of the whole machine
    starts        the same search from other start points, None if it was not asked for
    known         all numbers of the machine, found ones in the place of the files'
    interrupted   would there have been more?
    """

    recordings: tuple[Recording, ...]
    findings: tuple[Finding, ...]
    skipped: Mapping[str, str]
    refined: Refined | None
    starts: Starts | None
    known: Known
    interrupted: bool = False

    @property
    def estimates(self) -> dict[str, tuple[Estimate, str]]:
        """Name -> estimate and the procedure that found it; the joint refinement has the last word."""
        told = [(e, f.procedure) for f in self.findings for e in f.estimates]
        if self.refined is not None:
            told += [(e, MACHINE) for e in self.refined.estimates(names=parameters())]
        named = [(replace(e, name=plain(e.name, self.known)), procedure) for e, procedure in told]
        return {e.name: (e, procedure) for e, procedure in named}


def identify(
    recordings: Sequence[Recording],
    *,
    known: Known | None = None,
    joint: bool = True,
    inertial: bool = False,
    names: Sequence[str] = machine.FREE,
    starts: int = 0,
    tell: Tell = lambda _: None,
    show: Callable[[Finding], None] = lambda _: None,
) -> Identified:
    """Identify whatever the recordings allow.

    known      numbers to start from, `part.name`; by default those of the parameter files
    joint      refine together if there are recordings of the machine
    inertial   also estimate inertial parameters by themselves, which the paper took from CAD
    names      parameters of the joint refinement
    starts     from how many random points to search again: does the result depend on where it began?
    tell       takes a line about what happens, `show` what each procedure found
    """
    given = {r.procedure for r in recordings if r.use == "train"}
    unknown = sorted(given - {*PROCEDURES, MACHINE})
    if unknown:
        wanted = ", ".join((*PROCEDURES, MACHINE))
        raise Problem(f"[experiment] procedure is {unknown[0]!r}, expected one of {wanted}")
    machine.checked(names)
    for remark in remarks(recordings):
        tell(remark)
    steps = Steps(recordings, dict(known or nominal()), tell, show)
    interrupted = False
    try:
        steps.procedures(given, inertial)
        if joint and MACHINE in given:
            interrupted = not steps.together(names, starts)
    except KeyboardInterrupt:  # what was found until then is kept
        if not steps.findings and steps.refined is None:
            raise
        interrupted = True
    if not steps.findings and steps.refined is None:
        raise Problem(f"nothing was identified: {_nothing(given, joint)}")
    return Identified(
        recordings=tuple(recordings),
        findings=tuple(steps.findings),
        skipped=steps.skipped,
        refined=steps.refined,
        starts=steps.starts,
        known=steps.numbers,
        interrupted=interrupted,
    )


def _nothing(given: set[str], joint: bool) -> str:
    """Why there is no result."""
    if not given:
        return 'all recordings are held out, expected one with use = "train"'
    if given == {MACHINE} and not joint:
        return "there are only recordings of the whole machine, which the joint refinement needs"
    return f"expected usable recordings of {', '.join(sorted(given))}"
