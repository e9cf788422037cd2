"""Rules that load and run the FMU, in child processes: a crash, a hang or an exit is a finding, too.

First the FMU is loaded and its default experiment is run. What comes to its end there is probed further, by
the tasks in probes.toml.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from orchestrator.check.finding import MAKE, Check, CheckRule, Finding, note
from orchestrator.check.probe_process import Outcome, in_parallel, run
from orchestrator.check.subject import DESCRIPTION, Subject
from orchestrator.fmi.library import ARM, SYSTEM, find_library, platform_folders
from orchestrator.fmi.raw_description import INTERFACES, ModelDescription

KINDS = ("CoSimulation", "ModelExchange")


@dataclass(frozen=True)
class FirstRun:
    """How the FMU did before the other probes: by interface, how it was loaded, and how it ran by default.

    problem   why it cannot be run at all
    """

    loaded: dict[str, Outcome] = field(default_factory=dict)
    ran: dict[str, Outcome] = field(default_factory=dict)
    problem: str = ""

    @property
    def kinds(self) -> Sequence[str]:
        """The interfaces for which there is a binary."""
        return tuple(self.loaded)

    def sound(self, kind: str) -> bool:
        """Did the default experiment come to its end?"""
        return kind in self.ran and self.ran[kind].result is not None


_known: dict[Path, FirstRun] = {}  # of the FMU under check; one entry


def first_run(subject: Subject) -> FirstRun:
    """Load and run the FMU once; remembered while the same FMU is checked."""
    if subject.folder not in _known:
        found = _first_run(subject)
        _known.clear()
        _known[subject.folder] = found
    return _known[subject.folder]


def _first_run(subject: Subject) -> FirstRun:
    folder, model = subject.folder, subject.model
    if problem := _unreadable(model):
        return FirstRun(problem=f"modelDescription.xml cannot be read: {problem}")
    offered = [k for k in KINDS if k in model.interfaces]
    if not offered:
        return FirstRun(problem="neither co-simulation nor model exchange is offered")
    kinds = [k for k in offered if _has_binary(folder, model, k)]
    if not kinds:
        files = [p.relative_to(folder / "binaries") for p in (folder / "binaries").rglob("*") if p.is_file()]
        there = sorted({p.parts[0] for p in files if len(p.parts) > 1})
        wanted = " or ".join(_certain(model.major))
        text = f"no binary for this platform, expected {wanted}, found {', '.join(there) or 'none'}"
        return FirstRun(problem=text)

    def each(kinds: Sequence[str], task: str) -> dict[str, Outcome]:
        outcomes = in_parallel(lambda kind: run(folder, model, kind, task), kinds)
        return dict(zip(kinds, outcomes, strict=True))

    loaded = each(kinds, "loading:load")
    return FirstRun(loaded, each([k for k in kinds if not loaded[k].failed], "values:default"))


def _certain(fmi: int) -> list[str]:
    """Folders that are for this processor without doubt: linux64 does not tell it, darwin64 is for both."""
    return platform_folders(fmi)[:1] if ARM and SYSTEM != "darwin" else platform_folders(fmi)


def _has_binary(folder: Path, model: ModelDescription, kind: str) -> bool:
    path = find_library(folder, model.interfaces[kind].get("modelIdentifier"), model.major)
    return path is not None and path.parent.name in _certain(model.major)


def _unreadable(model: ModelDescription) -> str:
    """What in the description is missing or no number, though running the FMU needs it."""
    if not model.major:
        return f"fmiVersion is {model.attributes.get('fmiVersion')!r}, expected 2.0 or 3.0"
    try:
        for v in model.variables:
            if not v.name or v.reference is None:
                return f"{v}: expected a name and a value reference"
            _ = v.size, v.start, v.minimum, v.maximum, v.nominal
        for unknown in (*model.structure.get("outputs", ()), *model.structure.get("derivatives", ())):
            if unknown.variable is None:
                return f"{unknown}: expected a variable, found none with number {unknown.key}"
        entries = [model.experiment.attributes] if model.experiment else []
        numbers = [value for entry in entries for value in entry.values()]
        numbers += [e.get("fixedInternalStepSize", "0") for e in model.interfaces.values()]
        for text in numbers:
            float(text)
        int(model.attributes.get("numberOfEventIndicators", "0"))
    except (ValueError, OverflowError) as error:
        return str(error)
    return ""


def _findings(found: FirstRun, outcomes: dict[str, Outcome], crash: str = "error") -> Iterator[Finding]:
    """What was said; what both interfaces say is said once."""
    said: dict[tuple[str, str], list[str]] = {}
    for kind, outcome in outcomes.items():
        ends = [(crash, text) for text in outcome.crashes]
        ends += [("note" if outcome.late else crash, outcome.end)] if outcome.end else []
        for line in [*outcome.said, *ends]:
            said.setdefault(line, []).append(kind)
    for (severity, text), by in said.items():
        where = f"{INTERFACES[by[0]]}: " if len(found.kinds) > 1 and len(by) == 1 else ""
        yield MAKE[severity](where + text)


# ---- rules


def _possible(subject: Subject) -> Iterator[Finding]:
    """Why nothing is run; what is no FMU at all is the business of other rules."""
    found = first_run(subject)
    if found.problem and (subject.folder / DESCRIPTION).is_file():
        yield note(f"{found.problem}: the FMU was not run")


def _loads(subject: Subject) -> Iterator[Finding]:
    """The first probe."""
    found = first_run(subject)
    yield from _findings(found, found.loaded)


def _runs(subject: Subject) -> Iterator[Finding]:
    """The default experiment."""
    found = first_run(subject)
    yield from _findings(found, found.ran)
    for kind in (k for k in found.ran if not found.sound(k)):
        text = "the other probes did not run, because this one did not come to its end"
        yield note(f"{INTERFACES[kind]}: {text}")


def _probe(
    tasks: Sequence[str], kind: str = "", needs: Sequence[str] = (), fmi: int = 0, crash: str = "error"
) -> Check:
    """A check made of tasks, see probes.toml."""

    def check(subject: Subject) -> Iterable[Finding]:
        found, model = first_run(subject), subject.model
        kinds = [k for k in found.kinds if found.sound(k) and kind in ("", k)]
        able = [
            k
            for k in kinds
            if fmi in (0, model.major) and (not needs or model.interfaces[k].declares(*needs))
        ]

        def work(kind: str) -> Outcome:
            whole = Outcome()
            for task in tasks:
                habits, handed = found.ran[kind].result, whole.result
                part = run(subject.folder, model, kind, task, habits, handed)
                part.said = [*whole.said, *part.said]
                whole = part
                if whole.end or whole.crashes:
                    break
            return whole

        yield from _findings(found, dict(zip(able, in_parallel(work, able), strict=True)), crash)

    return check


def _from_file() -> Iterator[CheckRule]:
    for name, entry in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items():
        text, threads = entry.pop("text"), tuple(entry.pop("threads", "").split())
        yield CheckRule(f"run.{name}", text, _probe(**entry), threads)


PROBES: tuple[CheckRule, ...] = (
    CheckRule("run.possible", "The FMU can be run on this machine, so that it can be tried", _possible),
    CheckRule(
        "run.load",
        "The binary for this machine loads and has the functions of its interfaces",
        _loads,
        ("PythonFMU#110", "FMPy#545", "FMPy#642"),
    ),
    CheckRule(
        "run.default",
        "The default experiment runs to its end with finite values",
        _runs,
        ("FMIKit#225", "OpenModelica#11229", "rumoca#347"),
    ),
    *_from_file(),
)
