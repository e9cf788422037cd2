"""The design of a study: samples in the unit cube, the numbers they stand for, one row per run.

Samples of each dimension are uniform on 0..1; a factor's number is the inverse of its distribution there, so
all methods know all distributions. Latin hypercube: McKay, Beckman and Conover, Technometrics 21 (1979);
Sobol: Joe and Kuo, SIAM J. Sci. Comput. 30 (2008), scrambled after Owen; Saltelli: Comput. Phys. Commun. 181
(2010); Morris: Technometrics 33 (1991).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from math import prod
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from orchestrator.studies.study import Choice, Factor, Study

LEVELS = 4  # of morris: as in its paper, with jumps of two thirds of the range
EDGE = 2.0**-53  # nearer to 0 or 1 an unbounded distribution would give infinite numbers
INNER = 0.01  # the lowest level of morris where the distribution has no least number: its 1 % quantile
UNBOUNDED = ("normal", "lognormal")

Unit = NDArray[np.float64]


def table(study: Study) -> pd.DataFrame:
    """All runs, one row each in the order of their numbers; the same study has the same table.

    Rows of one combination of crossed choices stand together, in the order of the samples.
    """
    cube = samples(study)
    once = {d.column: _numbers(study, d, cube[:, i]) for i, d in enumerate(study.dimensions)}
    same = {c.column: c.options[0] for c in study.settled}
    parts = []
    for options in product(*(c.options for c in study.crossed)):
        given = {c.column: [o] * len(cube) for c, o in zip(study.crossed, options, strict=True)}
        parts.append(pd.DataFrame({**same, **given, **once}, index=range(len(cube))))
    whole = pd.concat(parts, ignore_index=True)
    columns = [*(f.column for f in study.factors), *(c.column for c in study.choices)]
    return whole[columns].rename_axis("run")


def count(study: Study) -> int:
    """How many runs the table has."""
    k, options = len(study.dimensions), prod(len(c.options) for c in study.crossed)
    if study.method == "grid" or not k:
        return options * prod(_count(d) for d in study.dimensions)
    return options * study.runs * {"saltelli": k + 2, "morris": k + 1}.get(study.method, 1)


def samples(study: Study) -> Unit:
    """Samples in the unit cube, shape (samples, dimensions of the study)."""
    if not study.dimensions:
        return np.zeros((1, 0))
    return METHODS[study.method](study)


def problem(study: Study) -> dict[str, Any]:
    """The dimensions as SALib wants to know them, in the unit cube."""
    names = [d.column for d in study.dimensions]
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


# ---- methods


def _latin(study: Study) -> Unit:
    found: Unit = qmc.LatinHypercube(len(study.dimensions), rng=_rng(study)).random(study.runs)
    return found


def _sobol(study: Study) -> Unit:
    found: Unit = qmc.Sobol(len(study.dimensions), scramble=True, rng=_rng(study)).random(study.runs)
    return found


def _grid(study: Study) -> Unit:
    """Each value in the middle of its share of 0..1; the last dimension goes fastest."""
    counts = [_count(d) for d in study.dimensions]
    axes = [(np.arange(n) + 0.5) / n for n in counts]
    return np.array(list(product(*axes)))


def _saltelli(study: Study) -> Unit:
    from SALib.sample import sobol

    found: Unit = sobol.sample(problem(study), study.runs, calc_second_order=False, seed=study.seed)
    return found


def _morris(study: Study) -> Unit:
    from SALib.sample import morris

    found: Unit = morris.sample(problem(study), study.runs, num_levels=LEVELS, seed=study.seed)
    return found


METHODS: Mapping[str, Callable[[Study], Unit]] = {
    "latin": _latin,
    "sobol": _sobol,
    "grid": _grid,
    "saltelli": _saltelli,
    "morris": _morris,
}


def _rng(study: Study) -> np.random.Generator:
    return np.random.default_rng(study.seed)


# ---- from 0..1 to numbers


def _count(dimension: Factor | Choice) -> int:
    """How many values a dimension of a grid has."""
    if isinstance(dimension, Choice):
        return len(dimension.options)
    values = dimension.numbers["values"]
    assert isinstance(values, tuple)
    return len(values)


def _numbers(study: Study, dimension: Factor | Choice, u: Unit) -> Any:
    """The numbers or options that samples of one dimension stand for."""
    if isinstance(dimension, Choice):
        return [dimension.options[i] for i in _index(u, len(dimension.options))]
    if study.method == "morris" and dimension.distribution in UNBOUNDED:
        u = INNER + (1 - 2 * INNER) * u
    return quantile(dimension, u)


def quantile(factor: Factor, u: Unit) -> Unit:
    """Numbers of a factor below which a share u of them lies, shape as u."""
    n = factor.numbers
    if factor.distribution == "values":
        values = np.asarray(n["values"], dtype=np.float64)
        return values[_index(u, len(values))]
    if factor.distribution in UNBOUNDED:
        u = np.clip(u, EDGE, 1 - EDGE)
    found: Unit = _distribution(factor.distribution, n).ppf(u)
    return found


def _distribution(name: str, n: Mapping[str, Any]) -> Any:
    if name == "uniform":
        return stats.uniform(n["minimum"], n["maximum"] - n["minimum"])
    if name == "normal":
        return stats.norm(n["mean"], n["sd"])
    if name == "lognormal":  # mean and sd are those of the numbers, not of their logarithm
        spread = np.log1p((n["sd"] / n["mean"]) ** 2)
        return stats.lognorm(np.sqrt(spread), scale=n["mean"] * np.exp(-spread / 2))
    width = n["maximum"] - n["minimum"]
    return stats.triang((n["mode"] - n["minimum"]) / width, n["minimum"], width)


def _index(u: Unit, count: int) -> NDArray[np.intp]:
    """Which of `count` equal shares of 0..1 each sample lies in."""
    return np.minimum((u * count).astype(np.intp), count - 1)
