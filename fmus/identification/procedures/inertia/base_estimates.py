"""Values and intervals of the base parameters (`base_parameters`), by the same balance of momenta."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fmus.identification.finding import Estimate
from fmus.identification.procedures.balance import modulation, uncertainty
from fmus.identification.procedures.balance.equation import Equation
from fmus.identification.procedures.balance.motion import PARAMETERS
from fmus.identification.procedures.balance.samples import Samples
from fmus.identification.procedures.balance.solution import Solution, normal_step
from fmus.identification.procedures.balance.uncertainty import Fit
from fmus.identification.procedures.inertia.base_parameters import (
    STANDARD,
    UNITS,
    Grouping,
    grouping,
    regressor,
    standard,
)
from fmus.identification.procedures.shared.regression import symmetrical

Array = NDArray[np.float64]


def base_estimates(records: Sequence[Samples], found: Solution, p: Array) -> list[Estimate]:
    """All base parameters, with the dampings among those found free beside them."""
    at = p.copy()
    at[[PARAMETERS.index(n) for n in found.theta]] = found.values + found.mean_effect
    group = grouping(at)
    free = [k for k, n in enumerate(found.theta) if n.endswith("damping")]
    equations = [_equation(s, e, free, group, at) for s, e in zip(records, found.equations, strict=True)]
    names = tuple(group.names())
    normal, step = normal_step(equations, found.weights, (*names, *(found.theta[k] for k in free)))
    fit = Fit(names, [0, 1, 2], found.weights, np.array(np.linalg.inv(normal), float), at)
    moved = [e.moved(step) for e in equations]
    noise, residual = (
        uncertainty.by_noise(fit, records, moved)[0],
        uncertainty.by_residuals(fit, records, moved),
    )
    sd = np.sqrt(np.diag(residual if found.lacks else noise))
    values = group.values(standard(at)) + step[: len(names)]
    units = [UNITS[k] for k in group.kept]
    return [
        symmetrical(name, float(value), unit, float(one), "base parameter: what any motion can tell at most")
        for name, value, unit, one in zip(names, values, units, sd, strict=False)
    ]


def _equation(s: Samples, e: Equation, free: Sequence[int], group: Grouping, p: Array) -> Equation:
    """The residual with its slopes over the base parameters and some of those found."""
    n = s.q.shape[1]
    by_momentum, by_force = (
        np.moveaxis(np.array(x.full()).reshape(3, n, len(STANDARD)), 2, 0)[list(group.kept)]
        for x in regressor()(s.q, s.w, np.zeros_like(s.q), p)[:2]
    )
    slopes = [
        (modulation.apply(s.filters.bump, f) - modulation.apply(s.filters.slope, h)) * s.good
        for f, h in zip(by_force, by_momentum, strict=True)
    ]
    return Equation(e.error, np.concatenate([slopes, e.slope[list(free)]]))
