"""The experiment that an FMU ships (FMI-LS-REF): run it and compare.

error of a signal = root mean square of its deviation, over the range of the reference (NRMSE)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from orchestrator.check.experiment_files import MANIFEST, Case, Related, experiments, manifest, shown
from orchestrator.check.experiment_run import Comparison, compare
from orchestrator.check.finding import Finding, Rule, error, note, warning
from orchestrator.check.probes.rules import life
from orchestrator.check.subject import Subject
from orchestrator.errors import Problem

WRONG, POOR = 1e-2, 1e-3  # errors from which they are worth an error, a warning
LISTED = 6  # signals in a text


def _experiment(subject: Subject) -> Iterable[Finding]:
    folder = subject.folder.resolve()
    if not (folder / MANIFEST).is_file():
        return
    try:
        related = manifest(folder)
    except Problem as problem:
        yield warning(_inside(folder, problem))
        return
    yield from _missing(related)
    found, texts = cases(folder, related)
    for text in texts:
        yield warning(text)
    for case in found:
        yield from _judged(subject, case)


def _inside(folder: Path, problem: Problem) -> str:
    """The text without the folder for the time of the check."""
    return str(problem).replace(f"{folder}/", "")


def _missing(related: list[Related]) -> Iterator[Finding]:
    for r in related:
        if r.path is None:
            yield note(f'{MANIFEST}: "{r.source}" lies outside of the FMU and was not looked at')
        elif not r.path.is_file():
            yield warning(f'{MANIFEST}: "{r.source}" (role {r.role}) is missing in the FMU')


# ---- which experiments there are


def cases(folder: Path, related: list[Related]) -> tuple[list[Case], list[str]]:
    """Experiments of the files with this role, then results without experiment; and what is left out."""
    there = [r for r in related if r.path is not None and r.path.is_file()]
    found: list[Case] = []
    texts: list[str] = []
    for r in there:
        if r.path is None or r.role.partition("/")[0] != "experiment":
            continue
        try:
            for case in experiments(folder, r.path):
                if isinstance(case, Case):
                    found.append(case)
                else:
                    texts.append(f"{shown(folder, r.path)}: {case}")
        except Problem as problem:
            texts.append(_inside(folder, problem))
    used = {case.reference for case in found}
    sets = [r.path for r in there if r.role == "parameter" and str(r.path).endswith(".ssv")]
    for r in there:
        if r.path is None or r.role != "result" or r.path in used or r.path.suffix.lower() != ".csv":
            continue
        one = sets[0] if len(sets) == 1 else None  # several are variants: none of them is the default
        found.append(Case(r.path.stem, r.path, one, _beside(r.path)))
    return found, texts


def _beside(result: Path) -> Path | None:
    """The inputs that belong to a result by their name: model_in.csv beside model_out.csv."""
    stem = result.stem
    for ending in ("_out", "_result", "_ref"):
        stem = stem.removesuffix(ending)
    names = (result.with_name(f"{stem}{ending}.csv") for ending in ("_in", "_input"))
    return next((p for p in names if p.is_file()), None)


# ---- how well they are met


def _judged(subject: Subject, case: Case) -> Iterator[Finding]:
    found = life(subject)
    if found.problem:
        yield note(f'experiment "{case.name}" was not run: {found.problem}')
        return
    try:
        result = compare(subject, case)
    except Problem as problem:
        yield warning(f'experiment "{case.name}": {_inside(subject.folder.resolve(), problem)}')
        return
    for text in result.problems:
        yield warning(f'experiment "{case.name}": {text}')
    if result.end:
        say = note if result.late else error
        yield say(f'experiment "{case.name}" does not come to its end: {result.end}')
    elif result.errors:
        yield _summary(case, result)


def _summary(case: Case, result: Comparison) -> Finding:
    """The signals, worst first."""
    ranked = sorted(result.errors.items(), key=lambda item: -item[1])
    worst = ranked[0][1]
    texts = [f"{name} {value:.2g}" for name, value in ranked[:LISTED]]
    more = f" and {len(ranked) - LISTED} more" if len(ranked) > LISTED else ""
    word = "differs from" if worst > POOR else "agrees with"
    text = f'experiment "{case.name}" {word} {case.reference.name}: NRMSE over range {", ".join(texts)}{more}'
    return (error if worst > WRONG else warning if worst > POOR else note)(text)


EXPERIMENT = Rule(
    "reference.result", "The experiment that the FMU ships gives the result it ships", _experiment
)
