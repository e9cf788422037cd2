"""Elementary effects of a Morris design: mu* and sigma by SALib.

    d_i = (y(x with x_i moved by delta) - y(x)) / delta        mu* = mean |d_i|        sigma = sd of d_i

delta is a share of the factor's range (in probability): mu* is what the output changes over the whole range,
in its unit. Morris (1991), Technometrics 33, 161-174; mu*: Campolongo et al. (2007), Environmental
Modelling & Software 22, 1509-1518. It orders factors; it is no share of a variance.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from SALib.analyze import morris

from orchestrator.sweep.analysis.outcome import MU_STAR, Effect, Estimate, Sensitivity
from orchestrator.sweep.analysis.resampling import RESAMPLES, SEED, intervals, ordered
from orchestrator.sweep.analysis.results import Array, Samples, kind, name
from orchestrator.sweep.analysis.variance import rank_correlations
from orchestrator.sweep.design import LEVELS

METHOD = "elementary effects of a Morris design"
LEAST = 4  # trajectories


def elementary_effects(samples: Samples) -> Sensitivity | str:
    """mu* and sigma of each factor; of choices the mean change of the output. A reason if nothing is left."""
    width = len(samples.names) + 1
    count = len(samples.y) // width
    kept = np.flatnonzero(samples.complete[: count * width].reshape(count, width).all(axis=1))
    if len(kept) < LEAST:
        return f"{len(kept)} of {count} trajectories are without a failed run, expected at least {LEAST}"
    design = samples.at((kept[:, None] * width + np.arange(width)).ravel())
    apart = {which: _factors(design.alone(c)) for c, which in enumerate(design.combinations)}
    effects = _pooled(list(apart.values())) + _choices(design)
    notes = ["mu* orders factors by what they change over their whole range; it is no share of a variance"]
    if len(kept) < count:
        notes.append(f"{count - len(kept)} of {count} trajectories are left out, as one of their runs failed")
    return Sensitivity(
        METHOD,
        MU_STAR,
        len(kept),
        float(design.y.var()),
        ordered(effects, MU_STAR),
        {which: ordered(found, MU_STAR) for which, found in apart.items()} if samples.crossed else {},
        notes=tuple(notes),
    )


def _factors(design: Samples) -> list[Effect]:
    """One combination of choices."""
    y = design.y[:, 0]
    problem = {
        "num_vars": len(design.names),
        "names": list(design.names),
        "bounds": [[0.0, 1.0]] * len(design.names),
    }
    found = morris.analyze(
        problem, design.x, y, num_levels=LEVELS, num_resamples=RESAMPLES, seed=np.random.default_rng(SEED)
    )
    directions = rank_correlations(design, y)
    columns = (np.asarray(found[key], dtype=float) for key in ("mu_star", "mu_star_conf", "mu", "sigma"))
    return [
        Effect(
            name(dimension),
            kind(dimension),
            {MU_STAR: Estimate(float(star), float(star - half), float(star + half))},
            {"mu": float(mu), "sigma": float(sigma)},
            direction,
        )
        for dimension, star, half, mu, sigma, direction in zip(
            design.dimensions, *columns, directions, strict=True
        )
    ]


def _pooled(apart: list[list[Effect]]) -> list[Effect]:
    """Mean over the combinations; so is the width of the interval, as if all erred alike: never too small."""
    pooled = []
    for same in zip(*apart, strict=True):
        stars = [effect.estimates[MU_STAR] for effect in same]
        value, half = np.mean([s.value for s in stars]), np.mean([s.ceiling - s.value for s in stars])
        mu = np.array([effect.more["mu"] for effect in same])
        sigma = np.sqrt(np.mean([effect.more["sigma"] ** 2 for effect in same]) + mu.var())
        estimate = Estimate(float(value), float(value - half), float(value + half))
        more = {"mu": float(mu.mean()), "sigma": float(sigma)}
        known = [effect.direction for effect in same if effect.direction is not None]
        direction = float(np.mean(known)) if known else None
        pooled.append(Effect(same[0].name, same[0].kind, {MU_STAR: estimate}, more, direction))
    return pooled


def _mean_size(differences: Array, rows: NDArray[np.intp]) -> Array:
    return np.array([np.abs(differences[rows]).mean()])


def _choices(design: Samples) -> list[Effect]:
    """Crossed choices: mean absolute difference of two options, all else equal."""
    width = len(design.names) + 1
    shape = (len(design.y) // width, width, *(len(choice.options) for choice in design.crossed))
    y = design.y.reshape(shape)
    effects = []
    for axis, choice in enumerate(design.crossed, start=2):
        differences = _pairs(np.moveaxis(y, axis, -1))
        star = intervals(partial(_mean_size, differences), len(y))[0]
        more = {"mu": float(differences.mean()), "sigma": float(differences.std())}
        effects.append(Effect(choice.what, "choice", {MU_STAR: star}, more))
    return effects


def _pairs(y: Array) -> Array:
    """Differences of each two entries along the last axis, later less earlier."""
    first, second = np.triu_indices(y.shape[-1], 1)
    found: Array = y[..., second] - y[..., first]
    return found
