"""Design of experiments: samples in the unit cube, the values of factors and choices, and the runs.

Samples of each dimension are uniform on 0..1. The value of a factor is the inverse of its distribution
function at the sample, so every method supports every distribution.

    latin      McKay, Beckman and Conover, Technometrics 21 (1979)
    sobol      Joe and Kuo, SIAM J. Sci. Comput. 30 (2008), scrambled after Owen
    saltelli   Saltelli et al., Comput. Phys. Commun. 181 (2010)
    morris     Morris, Technometrics 33 (1991)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from orchestrator.data.table import Array
from orchestrator.engine.job import Job
from orchestrator.fmi.description import Value
from orchestrator.ssp.system import Port, coerce
from orchestrator.studies.cases import Options, Sample, is_real, nominals
from orchestrator.studies.study import START, Choice, Factor, Study, levels

LEVELS = 4  # Morris levels, as in the paper: steps of two thirds of the range
EDGE = 2.0**-53  # smallest distance from 0 and 1: there quantiles of unbounded distributions are infinite
LOWEST_LEVEL = 0.01  # lowest Morris level of an unbounded distribution: its 1 % quantile
UNBOUNDED = ("normal", "lognormal")
TYPES = {"Real": pa.float64(), "Integer": pa.int64(), "Enumeration": pa.int64(), "Boolean": pa.bool_()}


# ---- samples in the unit cube


def samples(study: Study) -> Array:
    """Samples in the unit cube, shape (samples, dimensions of the study)."""
    count, runs, method = len(study.dimensions), study.runs, study.method
    if not count:
        return np.zeros((1, 0))
    if method == "grid":  # each value in the middle of its interval; the last dimension varies fastest
        counts = [levels(d) for d in study.dimensions]
        return np.array(list(product(*((np.arange(n) + 0.5) / n for n in counts))))
    if method in ("latin", "sobol"):
        rng = np.random.default_rng(study.seed)
        engine = qmc.LatinHypercube(count, rng=rng) if method == "latin" else qmc.Sobol(count, rng=rng)
        return np.asarray(engine.random(runs))
    from SALib.sample import morris, sobol

    dimensions = problem([d.column for d in study.dimensions])
    if method == "saltelli":
        return np.asarray(sobol.sample(dimensions, runs, calc_second_order=False, seed=study.seed))
    return np.asarray(morris.sample(dimensions, runs, num_levels=LEVELS, seed=study.seed))


def problem(names: Sequence[str]) -> dict[str, Any]:
    """Dimensions in the form of SALib, in the unit cube."""
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


# ---- values of factors and choices


def table(study: Study) -> pd.DataFrame:
    """All runs, one row each in the order of their numbers; the same study has the same table.

    Rows of one combination of crossed choices are adjacent, in the order of the samples.
    """
    cube = samples(study)
    sampled = {d.column: _values(study, d, cube[:, i]) for i, d in enumerate(study.dimensions)}
    each = [c for c in study.choices if c not in study.dimensions]
    options = pd.DataFrame([*product(*(c.options for c in each))], columns=[c.column for c in each])
    runs = options.merge(pd.DataFrame(sampled, index=range(len(cube))), how="cross")
    columns = [*(f.column for f in study.factors), *(c.column for c in study.choices)]
    return runs[columns].rename_axis("run")


def _values(study: Study, dimension: Factor | Choice, u: Array) -> Any:
    """The values or options of one dimension at samples."""
    if isinstance(dimension, Choice):
        return [dimension.options[i] for i in _index(u, len(dimension.options))]
    if study.method == "morris" and dimension.distribution in UNBOUNDED:
        u = LOWEST_LEVEL + (1 - 2 * LOWEST_LEVEL) * u
    return quantile(dimension, u)


def quantile(factor: Factor, u: Array) -> Array:
    """Quantiles of a factor at probabilities u, shape as u."""
    n = factor.numbers
    if factor.distribution == "values":
        return np.asarray(n["values"], np.float64)[_index(u, len(n["values"]))]
    if factor.distribution in UNBOUNDED:
        u = np.clip(u, EDGE, 1 - EDGE)
    return np.asarray(_distribution(factor.distribution, n).ppf(u), np.float64)


def _distribution(name: str, n: Mapping[str, Any]) -> Any:
    if name == "uniform":
        return stats.uniform(n["minimum"], n["maximum"] - n["minimum"])
    if name == "normal":
        return stats.norm(n["mean"], n["sd"])
    if name == "lognormal":  # mean and sd of the factor, not of its logarithm
        variance = np.log1p((n["sd"] / n["mean"]) ** 2)
        return stats.lognorm(np.sqrt(variance), scale=n["mean"] * np.exp(-variance / 2))
    width = n["maximum"] - n["minimum"]
    return stats.triang((n["mode"] - n["minimum"]) / width, n["minimum"], width)


def _index(u: Array, count: int) -> NDArray[np.intp]:
    """Index of the interval that contains each sample, of `count` equal intervals of 0..1."""
    return np.minimum((u * count).astype(np.intp), count - 1)


# ---- the runs


@dataclass(frozen=True)
class Samples(Sequence[Sample]):
    """Runs of a study, each made when it is asked for: a million would take gigabytes.

    rows      their numbers
    options   of all runs of the study
    values    makes the values of the factors from the number and the options of a run
    """

    rows: Sequence[int]
    options: Sequence[Options]
    values: Callable[[int, Options], Mapping[str, Value]]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, index: Any) -> Any:
        """A sample, or those of a slice."""
        if isinstance(index, slice):
            return self.at(self.rows[index])
        run = self.rows[index]
        return Sample(run, self.options[run], self.values(run, self.options[run]))

    def __reduce__(self) -> tuple[Any, ...]:
        return tuple, ([*self],)  # other processes get what they need

    def at(self, rows: Sequence[int]) -> Samples:
        """The runs with these numbers."""
        return replace(self, rows=rows)


def runs(study: Study, table: pd.DataFrame, cases: Mapping[Options, Job]) -> Samples:
    """The runs of a study in the order of its table; relative numbers become values."""
    scales = {o: nominals(study, case.system) for o, case in cases.items()}
    integers = {o: {n for n in scales[o] if not is_real(case.system, n)} for o, case in cases.items()}
    same: dict[Options, Options] = {}  # one object for all runs with equal options
    each = zip(*(table[c.column] for c in study.choices), strict=True)
    options = [same.setdefault(o, o) for o in each] or [()] * len(table)
    columns = {f.name: table[f.column].to_numpy() for f in study.factors}

    def values(run: int, chosen: Options) -> Mapping[str, Value]:
        found = {n: float(columns[n][run]) * scale for n, scale in scales[chosen].items()}
        return found | {n: int(found[n]) for n in integers[chosen]}

    return Samples(range(len(table)), options, values)


def starts(
    study: Study, cases: Mapping[Options, Job], samples: Sequence[Sample]
) -> tuple[dict[str, pa.Array], dict[str, str]]:
    """Start values and parameter values of each run as columns, and their units.

    One row per sample; a column `start:component.variable` for each variable that can be set in some case.
    Inputs with a connection or a column of a scenario are left out; null: the variant lacks the variable.
    """
    samples = [*samples]
    rows: dict[Options, list[int]] = {options: [] for options in cases}
    for i, sample in enumerate(samples):
        rows[sample.options].append(i)
    types, columns, units = dict[str, pa.DataType](), dict[str, NDArray[np.object_]](), dict[str, str]()
    for options, case in cases.items():
        names = [f.name for f in study.factors if case.system.has(f.name)]
        varied = {port: (name, linear) for name in names for port, linear in case.system.targets(name)}
        for port in _settable(case):
            variable, name = case.system.variable(port), f"{START}{port}"
            types[name] = TYPES.get(variable.kind, pa.string())
            if variable.unit:
                units[name] = variable.unit.name
            column = columns.setdefault(name, np.full(len(samples), None))
            if port in varied:
                factor, conversion = varied[port]
                for i in rows[options]:
                    column[i] = coerce(str(port), variable, samples[i].factors[factor], conversion)
            else:
                constant = case.system.components[port.component].value(port.variable)
                value = None if isinstance(constant, float) and np.isnan(constant) else constant
                column[rows[options]] = value
    return {name: pa.array(columns[name], types[name]) for name in columns}, units


def _settable(case: Job) -> list[Port]:
    """The variables of a case whose start value has an effect."""
    system = case.system
    driven = {c.target for c in system.connections}.union(case.scenario.columns if case.scenario else ())
    every = (Port(c.name, v.name) for c in system.components.values() for v in c.interface.variables.values())
    return [port for port in every if system.variable(port).settable and port not in driven]
