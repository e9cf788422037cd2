"""From recordings to parameters: the paper's procedures in its order, then all together.

What one procedure finds is known to the next. The result holds everything; nothing is written here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType

from fmus.contract import ModelError
from fmus.identification import machine
from fmus.identification.finding import Estimate, Finding
from fmus.identification.known import Known, nominal, plain, updated
from fmus.identification.procedures import (
    damping,
    hose_dynamics,
    hose_resistance,
    inertia,
    motor_leakage,
    valve,
)
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.names import parameters
from fmus.identification.refinement.refine import refine
from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.starts import Starts, from_random_starts

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


@dataclass(frozen=True)
class Identified:
    """What was found.

    findings   of the procedures that had recordings
    skipped    procedure -> why it found nothing
    refined    the joint refinement, None without recordings of the whole machine
    starts     the same search from other start points, None if it was not asked for
    known      all numbers of the machine, found ones in the place of the files'
    """

    recordings: tuple[Recording, ...]
    findings: tuple[Finding, ...]
    skipped: Mapping[str, str]
    refined: Refined | None
    starts: Starts | None
    known: Known

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
        expected = ", ".join((*PROCEDURES, MACHINE))
        raise ModelError(f"[experiment] procedure is {unknown[0]!r}, expected one of {expected}")
    numbers = dict(known or nominal())
    findings: list[Finding] = []
    skipped: dict[str, str] = {}
    chosen = {**PROCEDURES, **({INERTIA: inertia} if inertial else {})}
    for name, procedure in chosen.items():
        if name not in given and not (name == INERTIA and given & {"damping", MACHINE}):
            skipped[name] = "no recording"
            continue
        try:
            finding = procedure.identify(recordings, numbers)
        except ModelError as error:  # the others can still be found
            skipped[name] = str(error)
            tell(f"{name}: {error}")
            continue
        findings.append(finding)
        numbers = updated(numbers, finding.estimates)
        show(finding)
    refined = _together(recordings, numbers, names, tell) if joint and MACHINE in given else None
    if refined is not None:
        numbers = updated(numbers, refined.estimates(names=parameters()))
    again = _again(refined, starts, tell) if refined is not None and starts else None
    if not findings and refined is None:
        raise ModelError(f"nothing was identified: {_nothing(given, joint)}")
    return Identified(tuple(recordings), tuple(findings), skipped, refined, again, numbers)


def _nothing(given: set[str], joint: bool) -> str:
    """Why there is no result."""
    if not given:
        return 'all recordings are held out, expected one with use = "train"'
    if given == {MACHINE} and not joint:
        return "there are only recordings of the whole machine, which the joint refinement needs"
    return f"expected usable recordings of {', '.join(sorted(given))}"


def _together(recordings: Sequence[Recording], known: Known, names: Sequence[str], tell: Tell) -> Refined:
    task = machine.problem([r for r in recordings if r.procedure == MACHINE], known, names)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in task.training)
    tell(f"joint refinement: {len(task.free)} parameters, {len(task.outputs)} signals, {seconds:.0f} s;")
    tell("  predictions over half a second first, then whole recordings, then their weights")
    found = refine(
        task,
        progress=lambda p: tell(f"  iteration {p.iteration}: {p.predicted:.2g} standard deviations to go"),
    )
    size = found.history[-1].residual
    tell(f"  {found.reason}; residuals are {size:.3g} times what the sensors explain")
    return found


def _again(refined: Refined, count: int, tell: Tell) -> Starts:
    found = from_random_starts(refined, count=count)
    reached = round(found.share * count)
    tell(f"random starts: {reached} of {count} lead to the same result, on every fourth sample")
    return found
