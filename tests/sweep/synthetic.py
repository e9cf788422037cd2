"""Studies of functions whose sensitivity is known in closed form: the project's designs, no FMU."""

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd

from orchestrator.studies import design
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.results import Effect, OutputAnalysis
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor, Output, Study

PI = float(np.pi)
Columns = Mapping[str, np.ndarray]
Function = Callable[[Columns], np.ndarray]


def uniform(name: str, low: float, high: float) -> Factor:
    """A factor."""
    return Factor(name, "uniform", {"minimum": low, "maximum": high}, unit="m")


def results(
    function: Function,
    factors: Sequence[Factor],
    method: str,
    runs: int,
    choices: Sequence[Choice] = (),
    failed: Callable[[pd.DataFrame], np.ndarray] = lambda table: np.zeros(len(table), bool),
    seed: int = 5,
    unit: str = "Pa",
    reasons: Mapping[int, str] | None = None,
) -> Results:
    """A study of a function of its factors and choices, as if it had been run.

    failed    which rows of the table of runs count as failed
    reasons   of runs that failed, by their numbers
    """
    output = Output("peak", "part.pressure", "maximum", 0.0, 1.0, True, unit, unit)
    space = {"factors": tuple(factors), "choices": tuple(choices), "outputs": (output,)}
    study = Study("A function", "none.ssp", method, runs, seed, stop=1.0, **space)
    table = design.table(study).reset_index()
    columns = {f.name: table[f.column].to_numpy(float) for f in factors}
    columns |= {c.name: table[c.column].to_numpy(str) for c in choices}
    reasons = reasons or dict.fromkeys(np.flatnonzero(failed(table)), "state became inf at 0.4 s")
    bad = table["run"].isin(list(reasons))
    table[output.column] = np.where(bad, np.nan, function(columns))
    table["status"] = np.where(bad, "failed", "ok")
    table["reason"] = [reasons.get(run, "") for run in table["run"]]
    return Results(study, table, _bands(table, output), {output.signal: unit})


def every(count: int, first: int = 0) -> Callable[[pd.DataFrame], np.ndarray]:
    """Each of so many runs failed, from the first one on."""
    return lambda table: (table["run"] % count == first).to_numpy()


def finding(found: Results) -> OutputAnalysis:
    """What the analysis says about the only output."""
    return analyse(found).findings[0]


def effects(found: OutputAnalysis) -> dict[str, Effect]:
    """By name. In all analyses they stand in the order of the tornado: the largest first."""
    assert found.sensitivity is not None
    values = [effect.estimates[found.sensitivity.measure].value for effect in found.sensitivity.effects]
    assert all(a >= b for a, b in itertools.pairwise(values))
    return {effect.name: effect for effect in found.sensitivity.effects}


def ishigami(x: Columns) -> np.ndarray:
    """sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1, in units of 1e5 Pa so that a reader sees bar."""
    return 1e5 * (np.sin(x["x1"]) + 7 * np.sin(x["x2"]) ** 2 + 0.1 * x["x3"] ** 4 * np.sin(x["x1"]))


ISHIGAMI = tuple(uniform(name, -PI, PI) for name in ("x1", "x2", "x3"))


def ishigami_indices() -> dict[str, tuple[float, float]]:
    """First order and total of each factor [Ishigami and Homma 1990, ISUMA, 398-403]."""
    a, b = 7.0, 0.1
    one, two = 0.5 * (1 + b * PI**4 / 5) ** 2, a**2 / 8
    both = b**2 * PI**8 * (1 / 18 - 1 / 50)
    whole = one + two + both
    return {"x1": (one / whole, (one + both) / whole), "x2": (two / whole,) * 2, "x3": (0.0, both / whole)}


def _bands(table: pd.DataFrame, output: Output) -> pd.DataFrame:
    """The signal rises to its peak and falls again."""
    time = np.linspace(0.0, 1.0, 11)
    values = table[output.column].to_numpy()[:, None] * np.sin(PI * time)
    runs = np.repeat(table["run"].to_numpy(), len(time))
    return pd.DataFrame({"run": runs, "time": np.tile(time, len(table)), output.signal: values.ravel()})
