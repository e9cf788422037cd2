"""Designs: marginals, bounds, balance, determinism, and the order of the runs."""

import math
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.properties import examples
from scipy import stats

from orchestrator.studies.design import quantile, samples, table
from orchestrator.studies.study import METHODS, Choice, Factor, Study

UNIFORM = Factor("a.u", "uniform", {"minimum": -1.0, "maximum": 3.0})
NORMAL = Factor("a.n", "normal", {"mean": 2.0, "sd": 0.5})
LOGNORMAL = Factor("a.l", "lognormal", {"mean": 3.0, "sd": 1.5})
TRIANGULAR = Factor("a.t", "triangular", {"minimum": 0.0, "mode": 0.25, "maximum": 1.0})
VALUES = Factor("a.v", "values", {"values": (1.0, 2.0, 5.0)})
FACTORS = (UNIFORM, NORMAL, LOGNORMAL, TRIANGULAR, VALUES)


def made(method="latin", runs=16, seed=1, factors=FACTORS, choices=()):
    """A study of which only the design counts."""
    return Study("t", "s.fmu", method, runs, seed, 1.0, None, None, factors, choices, ())


finite = st.floats(-1e6, 1e6)
sizes = st.floats(1e-3, 1e6)
factors = st.one_of(
    st.builds(lambda a, w: Factor("x", "uniform", {"minimum": a, "maximum": a + w}), finite, sizes),
    st.builds(
        lambda a, w, s: Factor("x", "triangular", {"minimum": a, "mode": a + s * w, "maximum": a + w}),
        *(finite, sizes, st.floats(0, 1)),
    ),
    st.builds(lambda m, s: Factor("x", "normal", {"mean": m, "sd": s}), finite, sizes),
    st.builds(lambda m, s: Factor("x", "lognormal", {"mean": m, "sd": s * m}), sizes, st.floats(1e-2, 3)),
)
LIMITS = ("minimum", "maximum")


@examples(20)
@given(factor=factors, seed=st.integers(0, 2**32 - 1), method=st.sampled_from(["latin", "sobol", "morris"]))
def test_numbers_are_finite_and_within_their_bounds(factor, seed, method):
    """Of every method, also of those whose samples touch the ends of 0..1."""
    numbers = table(made(method, 16, seed, (factor,)))["factor:x"].to_numpy()
    assert np.isfinite(numbers).all()
    if set(LIMITS) <= set(factor.numbers):
        low, high = (factor.numbers[name] for name in LIMITS)
        least = 4 * np.spacing(max(abs(low), abs(high)))  # rounding of low + u (high - low)
        assert (numbers >= low - least).all()
        assert (numbers <= high + least).all()


@examples(20)
@given(factor=factors, seed=st.integers(0, 2**32 - 1))
def test_a_latin_hypercube_has_one_sample_in_each_share(factor, seed):
    """Each n-th of the distribution holds one of n samples, whatever the distribution."""
    numbers = np.sort(table(made("latin", 16, seed, (factor,)))["factor:x"])
    edges = quantile(factor, np.arange(17) / 16)
    least = 1e-9 * np.ptp(edges[1:-1])  # rounding of the inverse distribution functions
    assert (numbers >= edges[:-1] - least).all()
    assert (numbers <= edges[1:] + least).all()


def lognormal(x):
    """Distribution function of a lognormal number with a mean of 3 and a standard deviation of 1.5."""
    return NormalDist(math.log(3 / math.sqrt(1.25)), math.sqrt(math.log(1.25))).cdf(math.log(x))


@pytest.mark.parametrize(
    ("factor", "expected"),
    [
        (UNIFORM, lambda x: (x + 1) / 4),
        (NORMAL, NormalDist(2.0, 0.5).cdf),
        (LOGNORMAL, lognormal),
        (TRIANGULAR, lambda x: 4 * x**2 if x < 0.25 else 1 - (1 - x) ** 2 / 0.75),
    ],
    ids=[f.distribution for f in FACTORS[:4]],
)
def test_marginals_are_those_of_the_distribution(factor, expected):
    """Kolmogorov and Smirnov's distance of n stratified samples from the closed form is at most 1/n."""
    numbers = table(made("latin", 256, 5, (factor,))).iloc[:, 0]
    assert stats.kstest(numbers, np.vectorize(expected)).statistic <= 1 / 256


@pytest.mark.parametrize("method", METHODS)
def test_the_same_study_has_the_same_table(method):
    """To the last bit; another seed has another one, but for a grid, which has none."""
    each = (VALUES,) if method == "grid" else FACTORS
    first = table(made(method, factors=each))
    assert first.equals(table(made(method, factors=each)))
    other = table(made(method, factors=each, seed=2))
    assert first.equals(other) == (method == "grid")


def test_sobol_is_balanced():
    """Each half, quarter ... of each dimension holds as many samples as any other."""
    cube = samples(made("sobol", 64))
    for column in cube.T:
        assert np.bincount((column * 64).astype(int)).tolist() == [1] * 64


@pytest.mark.parametrize(("method", "count"), [("saltelli", 8 * (5 + 2)), ("morris", 8 * (5 + 1))])
def test_sensitivity_designs_have_their_sizes(method, count):
    """N (k + 2) and N (k + 1) runs; of morris each differs from the one before in one factor."""
    cube = samples(made(method, 8))
    assert cube.shape == (count, 5)
    if method == "morris":
        steps = np.diff(cube.reshape(8, 6, 5), axis=1)
        assert (np.count_nonzero(steps, axis=2) == 1).all()


def test_a_grid_has_every_combination_once():
    """In the order of the file, the last factor fastest."""
    other = Factor("a.w", "values", {"values": (0.0, 9.0)})
    rows = table(made("grid", 0, factors=(VALUES, other)))
    expected = [(a, b) for a in (1.0, 2.0, 5.0) for b in (0.0, 9.0)]
    assert list(rows.itertuples(index=False, name=None)) == expected


def test_values_and_sampled_options_are_equally_likely():
    """Of 48 stratified samples each of three values has 16; a sampled choice multiplies no runs."""
    arm = Choice("arm", ("x", "y", "z"), sampled=True)
    rows = table(made("latin", 48, factors=(VALUES,), choices=(arm,)))
    assert rows["factor:a.v"].value_counts().to_dict() == {1.0: 16, 2.0: 16, 5.0: 16}
    assert rows["choice:arm"].value_counts().to_dict() == {"x": 16, "y": 16, "z": 16}


def test_choices_are_crossed_with_every_sample():
    """Whose runs stand together and have the same samples; without factors each is run once."""
    choices = Choice("scenario", ("a", "b")), Choice("arm", ("x", "y", "z"))
    rows = table(made(runs=4, choices=choices))
    assert len(rows) == 24
    groups = [g for _, g in rows.groupby(["choice:scenario", "choice:arm"], sort=False)]
    assert [tuple(g.index) for g in groups] == [tuple(range(k, k + 4)) for k in range(0, 24, 4)]
    for group in groups:
        assert np.array_equal(group.filter(like="factor:"), groups[0].filter(like="factor:"))
    study = replace(made("grid", 0, factors=()), choices=(Choice("arm", ("x", "y")),))
    assert table(study)["choice:arm"].tolist() == ["x", "y"]
