"""From recordings to parameters: the paper's procedures in its order, then all together.

What one procedure finds is known to the next. The result holds everything; nothing is written here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from fmus.contract import ModelError
from fmus.identification import expected, machine
from fmus.identification.finding import Estimate, Finding
from fmus.identification.known import Known, nominal, plain
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.names import parameters
from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.starts import Starts
from fmus.identification.steps import MACHINE, PROCEDURES, Steps, Tell

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
        raise ModelError(f"[experiment] procedure is {unknown[0]!r}, expected one of {wanted}")
    machine.checked(names)
    for remark in expected.remarks(recordings):
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
        raise ModelError(f"nothing was identified: {_nothing(given, joint)}")
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
