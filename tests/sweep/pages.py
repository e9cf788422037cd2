"""Pages of studies of functions, each rendered once for all that is to be seen on it."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from sweep.synthetic import ISHIGAMI, Columns, every, ishigami, results, uniform

from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.results import Analysis
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor
from orchestrator.studies.study_page import NUMBERS, PAGE, write

TWO = Choice("swing", ("lumped", "detailed"))
MANY = Choice("pose", ("near", "nominal", "reach", "raised"))
# of one option: it holds for all runs
SINGLE = Choice("parameters", ("reach",)), Choice("scenario", ("levers.csv",), sampled=True)
UNIT = tuple(uniform(name, 0.0, 1.0) for name in ("x1", "x2"))


class Shown(NamedTuple):
    """A study with its analysis, its page and its numbers."""

    found: Results
    analysis: Analysis
    page: str
    numbers: dict[str, Any]


def written(found: Results) -> Shown:
    """What the report of a study is made of."""
    analysis = analyse(found)
    with TemporaryDirectory() as name:
        write(Path(name), found)
        page, numbers = (Path(name, file).read_text("utf-8") for file in (PAGE, NUMBERS))
    return Shown(found, analysis, page, json.loads(numbers))


@cache
def shown(case: str) -> Shown:
    """The report of one of the cases."""
    return written(CASES[case]())


def _length(x: Columns) -> np.ndarray:
    """Some millimetres, in m."""
    return 0.004 + 1e-3 * x["x1"] + 1e-4 * x["x2"]


def _failed() -> Results:
    """For one reason, and for another one with a number in it."""
    some = {25 * n: "state became inf at 0.4 s" if n % 2 else f"mass is {-n} kg" for n in range(1, 99)}
    return results(_length, UNIT, "saltelli", 32, [MANY], unit="m", reasons=some)


def _one_factor() -> Results:
    """With a title that could be markup, and values for all runs: with a unit, and of several variables."""
    found = results(lambda x: x["x1"], UNIT[:1], "latin", 20)
    study = replace(found.study, title="<b>peaks</b>", fixed={"supply.pressure": 2.0684e7, "levers": 3.6})
    return replace(found, study=study, units={**found.units, "start:supply.pressure": "Pa"})


CASES: dict[str, Callable[[], Results]] = {
    "saltelli": lambda: results(ishigami, ISHIGAMI, "saltelli", 32, [SINGLE[0], TWO, SINGLE[1]]),
    "latin": lambda: results(ishigami, ISHIGAMI, "latin", 220, SINGLE),
    "morris": lambda: results(_length, UNIT, "morris", 6, [TWO, MANY], unit="m"),
    "failed runs": _failed,
    "all failed": lambda: results(ishigami, ISHIGAMI, "latin", 20, failed=every(1)),
    "constant": lambda: results(lambda x: np.full(len(x["x1"]), 3e6), UNIT[:1], "latin", 20),
    "one factor": _one_factor,
    "one run": lambda: results(lambda x: x["x1"], UNIT[:1], "latin", 1),
    "choices only": lambda: results(lambda x: 1.0 * (x["swing"] == "lumped"), (), "grid", 0, [TWO]),
    "grid": lambda: results(
        lambda x: x["x1"] ** 2, [Factor("x1", "values", {"values": (1.0, 2.0)}, relative=True)], "grid", 0
    ),
    "no bands": lambda: replace(results(_length, UNIT, "latin", 30, unit="m"), bands=None),
}
