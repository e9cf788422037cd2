"""Studies of small FMUs that are run in no time, and what to compare of their results."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from kit.mistakes import problem

from orchestrator.studies.cases import resolve
from orchestrator.studies.parameter_study import sweep
from orchestrator.studies.runs import RunOutcome
from orchestrator.studies.store import Results
from orchestrator.studies.study import Study, read

GAIN, FAILS, MACHINE = (
    Path(__file__).with_name(f"{name}.toml").read_text("utf-8") for name in ("gain", "fails", "machine")
)
FACTOR = GAIN[GAIN.index("[factors") : GAIN.index("\n[fixed]")]


def uniform(low: float, high: float, more: str = "") -> str:
    """The numbers of a factor, as in a TOML file."""
    return f'distribution = "uniform", minimum = {low}, maximum = {high}{more}'


def machine(folder: Path, fmus: Path, name: str, numbers: str = uniform(1, 2)) -> Path:
    """The file of a study of the machine with one factor."""
    text = MACHINE.format(system=(fmus / "harvester.ssp").as_posix(), name=name, numbers=numbers)
    file = folder / "study.toml"
    file.write_text(text, encoding="utf-8")
    return file


def study(folder: Path, text: str, fmu: Path) -> Path:
    """The file of a study, with its FMU beside it."""
    (folder / fmu.name).write_bytes(fmu.read_bytes())
    file = folder / "study.toml"
    file.write_text(text, encoding="utf-8")
    return file


def resolved(file: Path, text: str | None = None) -> Study:
    """What a file says, also with another text in it, in the units of the FMUs."""
    if text is not None:
        file.write_text(text, encoding="utf-8")
    return resolve(read(file))[0]


def refused(file: Path, text: str | None = None) -> str:
    """The line about what is wrong with a study, without the name of its file."""
    line = problem(lambda: resolved(file, text))
    assert line.startswith(f"{file}: ")
    return line.removeprefix(f"{file}: ")


def run(file: Path, folder: str = "out", workers: int = 1, fresh: bool = False) -> tuple[Results, list[int]]:
    """The results of a study, and the runs that took place for them now."""
    runs: list[int] = []

    def note(_total: int, _done: int, batch: Sequence[RunOutcome]) -> None:
        runs.extend(outcome.run for outcome in batch)

    results = sweep(file, file.parent / folder, workers=workers, fresh=fresh, watch=note)
    return results, sorted(runs)


def content(folder: Path) -> Mapping[str, bytes]:
    """What must not depend on how a study was run, byte by byte."""
    files = sorted(folder.glob("*.parquet/*"))
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}
