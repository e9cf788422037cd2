"""From a rule to children and back to findings: which sides are probed, and what is worth the time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator.check.child.binary import find, folders
from orchestrator.check.child.description import Declared, read
from orchestrator.check.finding import Check, Finding, error, note, warning
from orchestrator.check.probes.parent import Outcome, run, side_by_side
from orchestrator.check.subject import DESCRIPTION, Subject

SIDES = {"cs": "co-simulation", "me": "model exchange"}
MAKE = {"error": error, "warning": warning, "note": note}


@dataclass(frozen=True)
class Life:
    """What is known of an FMU before the other probes begin: of each side, how the first two went."""

    declared: Declared | None
    sides: Sequence[str]
    loaded: dict[str, Outcome]
    lived: dict[str, Outcome]
    problem: str = ""

    def alive(self, side: str) -> bool:
        """Did the default experiment come to its end?"""
        return side in self.lived and self.lived[side].result is not None


_known: dict[Path, Life] = {}  # of the FMU under check; one entry


def life(subject: Subject) -> Life:
    """Load and run the FMU once; remembered while the same FMU is checked."""
    if subject.folder not in _known:
        found = _life(subject.folder)
        _known.clear()
        _known[subject.folder] = found
    return _known[subject.folder]


def _life(folder: Path) -> Life:
    try:
        declared = read(folder)
    except ValueError as problem:
        return Life(None, (), {}, {}, str(problem))
    if not declared.sides:
        return Life(declared, (), {}, {}, "neither co-simulation nor model exchange is offered")
    sides = [s for s in declared.sides if find(folder, declared, s) is not None]
    if not sides:
        files = [p.relative_to(folder / "binaries") for p in (folder / "binaries").rglob("*") if p.is_file()]
        there = sorted({p.parts[0] for p in files if len(p.parts) > 1})
        has = ", ".join(there) if there else "none"
        wanted = " or ".join(folders(declared.major))
        return Life(declared, (), {}, {}, f"no binary for this platform, expected {wanted}, found {has}")
    loaded = dict(zip(sides, _each(folder, sides, "loading:load"), strict=True))
    sound = [s for s in sides if not loaded[s].end and not _errors(loaded[s])]
    lived = dict(zip(sound, _each(folder, sound, "values:default"), strict=True))
    return Life(declared, sides, loaded, lived)


def _errors(outcome: Outcome) -> bool:
    return any(severity == "error" for severity, _ in outcome.said)


def _each(folder: Path, sides: Sequence[str], task: str) -> list[Outcome]:
    """One task for several sides."""
    return side_by_side(lambda side: run(folder, side, task), sides)


def _findings(sides: Sequence[str], outcomes: Sequence[Outcome], several: bool) -> Iterator[Finding]:
    """What was said; what both sides say is said once."""
    said: dict[tuple[str, str], list[str]] = {}
    for side, outcome in zip(sides, outcomes, strict=True):
        end = [("note" if outcome.late else "error", outcome.end)] if outcome.end else []
        for line in [*outcome.said, *end]:
            said.setdefault(line, []).append(side)
    for (severity, text), by in said.items():
        where = f"{SIDES[by[0]]}: " if several and len(by) == 1 else ""
        yield MAKE[severity](where + text)


# ---- rules


def possible(subject: Subject) -> Iterator[Finding]:
    """Why nothing is run; what is no FMU at all is told by other rules."""
    found = life(subject)
    if found.problem and (subject.folder / DESCRIPTION).is_file():
        yield note(f"{found.problem}: the FMU was not run")


def loads(subject: Subject) -> Iterator[Finding]:
    """The first probe."""
    found = life(subject)
    yield from _findings(list(found.loaded), list(found.loaded.values()), len(found.sides) > 1)


def runs(subject: Subject) -> Iterator[Finding]:
    """The default experiment."""
    found = life(subject)
    yield from _findings(list(found.lived), list(found.lived.values()), len(found.sides) > 1)
    for side in found.lived:
        if not found.alive(side):
            yield note(
                f"{SIDES[side]}: the other probes did not run, because this one did not come to its end"
            )


def probe(
    *tasks: str,
    sides: Sequence[str] = tuple(SIDES),
    needs: Sequence[str] = (),
    major: int = 0,
    crash: str = "error",
) -> Check:
    """A check made of tasks; what one hands over goes to the next.

    needs   capabilities, one of which must be declared
    major   FMI version that has it
    crash   how bad a crash is
    """

    def check(subject: Subject) -> Iterable[Finding]:
        found = life(subject)
        declared = found.declared
        if declared is None or (major and declared.major != major):
            return
        able = [s for s in sides if found.alive(s) and (not needs or _has(declared, s, needs))]

        def work(side: str) -> Outcome:
            whole = Outcome()
            for task in tasks:
                part = run(subject.folder, side, task, found.lived[side].result, whole.result)
                ends = [(crash, text) for text in part.crashes]
                ends += [("note" if part.late else crash, part.end)] if part.end else []
                whole.said += [*part.said, *ends]
                whole.result = part.result
                if ends:
                    break
            return whole

        yield from _findings(able, side_by_side(work, able), len(found.sides) > 1)

    return check


def _has(declared: Declared, side: str, needs: Sequence[str]) -> bool:
    """A capability: "true", or a number above zero."""
    values = [declared.sides[side].get(name, "") for name in needs]
    return any(v == "true" or (v.isdigit() and int(v) > 0) for v in values)
