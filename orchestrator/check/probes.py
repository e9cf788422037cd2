"""Rules that load and run the FMU in child processes: a crash, a hang or an exit is a finding, too.

First the FMU is loaded and its default experiment is run. If that is completed, the other rules follow.
"""

import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

from orchestrator.base.numerals import integer, real
from orchestrator.check.finding import MAKE, Finding, note
from orchestrator.check.probe_process import Outcome, run
from orchestrator.check.rule import rules_in
from orchestrator.check.subject import DESCRIPTION, Subject
from orchestrator.fmi.description import INTERFACES, ModelDescription
from orchestrator.fmi.library import ARM, SYSTEM, find_library, platform_folders

MAX_VARIABLES = 20_000  # in a run; each of 50 tasks needs 1 s for 20 000 variables
KINDS = ("CoSimulation", "ModelExchange")
ONCE = "canBeInstantiatedOnlyOncePerProcess"


@dataclass(frozen=True)
class FirstRun:
    """Outcomes of loading the FMU and of its default experiment, by interface.

    problem   why the FMU cannot be run at all
    model     the description for the child processes
    """

    loaded: dict[str, Outcome] = field(default_factory=dict)
    ran: dict[str, Outcome] = field(default_factory=dict)
    problem: str = ""
    model: ModelDescription = field(default_factory=ModelDescription)

    @property
    def kinds(self) -> Sequence[str]:
        """The interfaces with a binary for this machine."""
        return tuple(self.loaded)

    def completed(self, kind: str) -> bool:
        """The default experiment was completed."""
        return kind in self.ran and self.ran[kind].result is not None


_cache: dict[Path, FirstRun] = {}  # by folder of the FMU; only the latest FMU
_running = threading.Lock()


def first_run(subject: Subject) -> FirstRun:
    """Load and run the FMU; the result is cached while the same FMU is checked."""
    with _running:
        if subject.folder not in _cache:
            _cache.clear()
            _cache[subject.folder] = _first_run(subject)
        return _cache[subject.folder]


def _first_run(subject: Subject) -> FirstRun:
    folder, model = subject.folder, subject.model.for_run()
    if problem := _unreadable(subject.model):
        return FirstRun(problem=f"modelDescription.xml cannot be read: {problem}")
    if len(model.variables) > MAX_VARIABLES:
        text = f"expected at most {MAX_VARIABLES} inputs, outputs, parameters, states and dependencies"
        return FirstRun(problem=f"{text}, got {len(model.variables)}, for which the probes take too long")
    offered = [k for k in KINDS if k in model.interfaces]
    if not offered:
        return FirstRun(problem="the FMU offers neither co-simulation nor model exchange")
    kinds = [k for k in offered if _has_binary(folder, model, k)]
    if not kinds:
        files = [p.relative_to(folder / "binaries") for p in (folder / "binaries").rglob("*") if p.is_file()]
        present = sorted({p.parts[0] for p in files if len(p.parts) > 1})
        expected = " or ".join(_platform_folders(model.major))
        text = f"no binary for this platform, expected {expected}, got {', '.join(present) or 'none'}"
        return FirstRun(problem=text)

    def outcomes(kinds: Sequence[str], task: str) -> dict[str, Outcome]:
        with ThreadPoolExecutor() as pool:
            results = pool.map(lambda kind: run(folder, model, kind, task), kinds)
        return dict(zip(kinds, results, strict=True))

    loaded = outcomes(kinds, "loading:load")
    ran = outcomes([k for k in kinds if not loaded[k].failed], "values:default")
    for kind in [k for k in ran if ran[k].failure and not ran[k].late]:
        entry = model.interfaces[kind]
        once = replace(entry, attributes={**entry.attributes, ONCE: "true"})
        single = replace(model, interfaces={**model.interfaces, kind: once})
        outcome = run(folder, single, kind, "values:default")
        if outcome.result is not None:
            text = f"{ran[kind].failure} of a second instance in one process, expected {ONCE} to be declared"
            outcome.remarks.append(("error", f"{text}; other probes make one instance each"))
            model, ran[kind] = single, outcome
    return FirstRun(loaded, ran, model=model)


def _platform_folders(fmi: int) -> list[str]:
    """Folders with binaries for this processor; on ARM not linux64, which may be for x86_64."""
    return platform_folders(fmi)[:1] if ARM and SYSTEM != "darwin" else platform_folders(fmi)


def _has_binary(folder: Path, model: ModelDescription, kind: str) -> bool:
    path = find_library(folder, model.interfaces[kind].get("modelIdentifier"), model.major)
    return path is not None and path.parent.name in _platform_folders(model.major)


def _unreadable(model: ModelDescription) -> str:
    """The first entry of the description that is missing or not a number, although a run needs it."""
    if not model.major:
        return f"fmiVersion is {model.attributes.get('fmiVersion')!r}, expected 2.0 or 3.0"
    try:
        for v in model.variables:
            if not v.name or v.reference < 0:
                return f"{v}: expected a name and a value reference"
            _ = v.size, v.start_values, v.bounds, v.magnitude
        for unknown in (*model.structure.get("outputs", ()), *model.structure.get("derivatives", ())):
            if unknown.variable is None:
                return f"{unknown}: expected a variable, got none with index or reference {unknown.key}"
        numbers = list(model.experiment.attributes.values())
        numbers += [e.get("fixedInternalStepSize", "0") for e in model.interfaces.values()]
        _ = [*map(real, numbers)], integer(model.get("numberOfEventIndicators", "0"))
    except (ValueError, OverflowError) as error:
        return str(error)
    return ""


def _findings(first: FirstRun, outcomes: dict[str, Outcome]) -> Iterator[Finding]:
    """Remarks, crashes and failures as findings; what both interfaces have in common is one finding."""
    kinds_of: dict[tuple[str, str], list[str]] = {}
    for kind, outcome in outcomes.items():
        failures = [("error", text) for text in outcome.crashes]
        failures += [("note" if outcome.late else "error", outcome.failure)] if outcome.failure else []
        for remark in [*outcome.remarks, *failures]:
            kinds_of.setdefault(remark, []).append(kind)
    for (severity, text), kinds in kinds_of.items():
        prefix = f"{INTERFACES[kinds[0]]}: " if len(first.kinds) > 1 and len(kinds) == 1 else ""
        yield MAKE[severity](prefix + text)


# ---- rules


def run_possible(subject: Subject) -> Iterator[Finding]:
    """The FMU can be run on this machine.

    Other rules report a file that is not an FMU at all.
    """
    first = first_run(subject)
    if first.problem and (subject.folder / DESCRIPTION).is_file():
        yield note(f"{first.problem}: the FMU was not run")


def run_load(subject: Subject) -> Iterator[Finding]:
    """The binary for this machine loads, and returns the FMI version of the description."""
    first = first_run(subject)
    yield from _findings(first, first.loaded)


def run_default(subject: Subject) -> Iterator[Finding]:
    """The default experiment is completed with finite values."""
    first = first_run(subject)
    yield from _findings(first, first.ran)
    for kind in (k for k in first.ran if not first.completed(k)):
        text = "the other probes were skipped, because the default experiment was not completed"
        yield note(f"{INTERFACES[kind]}: {text}")


def probe(
    subject: Subject, tasks: Sequence[str], kind: str = "", needs: Sequence[str] = ()
) -> Iterator[Finding]:
    """Run tasks one after the other; the arguments are those of probes.toml."""
    first = first_run(subject)
    kinds = [k for k in first.kinds if first.completed(k) and kind in ("", k)]
    kinds = [k for k in kinds if not needs or first.model.interfaces[k].declares(*needs)]

    def work(kind: str) -> Outcome:
        outcome = Outcome()
        for task in tasks:
            remarks, payload = outcome.remarks, outcome.result
            outcome = run(subject.folder, first.model, kind, task, first.ran[kind].result, payload)
            outcome.remarks = [*remarks, *outcome.remarks]
            if outcome.failure or outcome.crashes:
                break
        return outcome

    yield from _findings(first, {kind: work(kind) for kind in kinds})


PROBES = rules_in(Path(__file__).with_suffix(".toml"), sys.modules[__name__])
