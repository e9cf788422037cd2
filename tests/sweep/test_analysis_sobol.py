"""Sobol' indices, Morris effects and main effects against functions whose answers are known."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pandas as pd
import pytest
from kit import shards
from SALib.analyze import morris, rbd_fast, sobol
from sweep.pages import MANY, SINGLE, TWO
from sweep.studies import run, study
from sweep.synthetic import ISHIGAMI, effects, every, finding, ishigami, ishigami_indices, results, uniform

from orchestrator.studies import design
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.results import FIRST, MU_STAR, TOTAL, IntervalEstimate, samples
from orchestrator.studies.analysis.sensitivity import RESAMPLES, intervals
from orchestrator.studies.store import read
from orchestrator.studies.study import Choice, Factor

LINEAR = {"x1": 4.0, "x2": -2.0, "x3": 1.0, "x4": 0.0}
UNIT = tuple(uniform(name, 0.0, 1.0) for name in LINEAR)
GRID = tuple(Factor(f.name, "values", {"values": (0.5, 1.0, 2.0)}, unit="m") for f in UNIT[:2])


def linear(x):
    """A sum of the factors with known weights."""
    return 10.0 + sum(weight * x[name] for name, weight in LINEAR.items())


def bent(x):
    """A function in which both factors act, alone and together."""
    return np.sin(3 * x["x1"]) + x["x1"] * x["x2"]


def near(estimate: IntervalEstimate, truth: float) -> bool:
    """Within 1.5 times half the 95 % interval, 3 standard deviations."""
    assert estimate.low is not None
    assert estimate.high is not None
    return abs(estimate.value - truth) <= 0.75 * (estimate.high - estimate.low)


def test_intervals_of_means_are_those_of_the_normal_distribution() -> None:
    """Means of 100 samples drawn with replacement are normal, with sd / 10: so are the ends of 95 %."""
    samples = np.random.default_rng(5).normal(size=(100, 400))
    found = intervals(lambda rows: samples[rows].mean(axis=0), 100)
    means, sd = samples.mean(axis=0), samples.std(axis=0) / 10
    np.testing.assert_array_equal([f.value for f in found], means)
    below = (means - [f.low for f in found]) / sd
    above = ([f.high for f in found] - means) / sd
    # 1.92, not yet 1.96: where the 2.5 % quantile of so few draws lies on average
    expected = -NormalDist().inv_cdf((0.025 * (RESAMPLES - 1) + 1) / (RESAMPLES + 1))
    # one such quantile has an sd of 0.13, the mean over 400 columns one of 0.007: four of these
    assert [below.mean(), above.mean()] == pytest.approx([expected, expected], abs=0.03)


def test_ishigami_has_its_closed_form_indices() -> None:
    """First order and total of all factors of the Ishigami function."""
    found = effects(finding(results(ishigami, ISHIGAMI, "saltelli", 512)))
    for name, (first, total) in ishigami_indices().items():
        assert near(found[name].estimates[FIRST], first)
        assert near(found[name].estimates[TOTAL], total)
        # 3 sd of 512 base samples; an estimator that mixed up rows would be off by 0.3 and more
        assert abs(found[name].estimates[TOTAL].value - total) < 0.12


def test_a_choice_takes_its_part_of_the_variance() -> None:
    """An option that adds a constant d moves Var = d^2 / 4; the factors share the rest as without it."""
    step = 4e5

    def stepped(x):
        return ishigami(x) + step * (x["swing"] == "detailed")

    found = effects(finding(results(stepped, ISHIGAMI, "saltelli", 512, [TWO])))
    own = 13.8446e10  # variance of the Ishigami function, in Pa^2
    part = own / (own + step**2 / 4)
    for key in (FIRST, TOTAL):
        assert near(found["swing"].estimates[key], 1 - part)
    for name, (first, total) in ishigami_indices().items():
        assert near(found[name].estimates[FIRST], part * first)
        assert near(found[name].estimates[TOTAL], part * total)


def test_a_choice_that_is_drawn_is_a_factor_like_others() -> None:
    """Sampled or crossed, a choice has the same share."""
    truth = 0.25 / (0.25 + 1 / 12)  # variances of a fair coin and of a uniform number
    for choice in (TWO, replace(TWO, sampled=True)):
        found = results(lambda x: x["x1"] + (x["swing"] == "detailed"), UNIT[:1], "saltelli", 512, [choice])
        share = effects(finding(found))["swing"].estimates[TOTAL]
        assert share.value == pytest.approx(truth, abs=0.05)  # 3 sd of 512 base samples


def test_a_factor_without_effect_has_none() -> None:
    """The interval of a factor that is not in the function holds zero, and is narrow."""
    found = effects(finding(results(linear, UNIT, "saltelli", 256)))["x4"]
    # exactly zero: columns of x4 change nothing, so all differences vanish
    assert found.estimates[TOTAL] == IntervalEstimate(0.0, 0.0, 0.0)
    assert found.estimates[FIRST].floor <= 0 <= found.estimates[FIRST].ceiling


def test_lost_base_samples_leave_the_indices_true() -> None:
    """They are left out; if many are lost, independent rows are a plain sample. Both are told."""
    found = finding(results(ishigami, ISHIGAMI, "saltelli", 512, failed=every(97, 5)))
    assert "base samples are left out" in found.sensitivity.notes[0]
    for name, (_, total) in ishigami_indices().items():
        assert near(effects(found)[name].estimates[TOTAL], total)
    found = finding(results(ishigami, ISHIGAMI, "saltelli", 256, failed=every(7, 2)))
    assert "too few for the estimators of a Saltelli design" in found.sensitivity.notes[0]
    assert "RBD-FAST" in found.sensitivity.method
    # 3 sd of first order indices from some 440 samples
    assert abs(effects(found)["x2"].estimates[FIRST].value - ishigami_indices()["x2"][0]) < 0.1


def mixed(x):
    """Not linear, with interactions, also between factors and the options of choices."""
    y = np.sin(3 * x["x1"]) + x["x1"] * x["x2"] + 0.2 * x["x3"] ** 2
    for choice in (TWO, MANY):
        if choice.name in x:
            index = np.array([choice.options.index(option) for option in x[choice.name]])
            y = y * (1 + 0.3 * index) + 0.5 * index
    return y


FAILURES = (lambda table: np.zeros(len(table), bool), every(211, 3))
SALIB = pytest.mark.parametrize(
    ("choices", "failed"),
    [
        ((), FAILURES[0]),
        ((), FAILURES[1]),
        ((TWO,), FAILURES[1]),
        ((MANY, TWO), FAILURES[0]),
        ((replace(MANY, sampled=True), TWO), FAILURES[1]),
    ],
    ids=["plain", "runs failed", "crossed", "two crossed", "sampled and crossed"],
)


STORED = """
title = "A product and a sum"
system = "gain.fmu"
method = "{method}"
runs = {runs}
seed = 3
stop = 0.02
step = 0.01
[factors]
"gain.factor" = {{ distribution = "uniform", minimum = 1, maximum = 3 }}
"gain.u" = {{ distribution = "uniform", minimum = -1, maximum = 2 }}
"gain.offset" = {{ distribution = "uniform", minimum = 0, maximum = 1 }}
[outputs]
peak = {{ signal = "gain.y", measure = "final" }}
"""
METHODS = (("saltelli", 16), ("morris", 6), ("latin", 200))


def assert_salib(method, found):
    """A study without choices has the numbers of SALib's `analyze`, called with the columns of its table."""
    table = found.table.sort_values("run")
    names = [factor.column for factor in found.study.factors]
    x, y = table[names].to_numpy(), table[found.study.outputs[0].column].to_numpy()
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    if method == "saltelli":
        theirs = sobol.analyze(problem, y, calc_second_order=False, num_resamples=2, seed=1)
        keys = {"S1": FIRST, "ST": TOTAL}
    elif method == "morris":
        theirs, keys = morris.analyze(problem, x, y, num_resamples=2, seed=1), {"mu_star": MU_STAR}
    else:
        theirs, keys = rbd_fast.analyze(problem, x, y, num_resamples=2, seed=1), {"S1": FIRST}
    ours = effects(finding(found))
    size = np.ptp(y) if method == "morris" else 1.0
    for key, measure in keys.items():
        values = [ours[factor.name].estimates[measure].value for factor in found.study.factors]
        # the same formulas: rounding only, of sums of numbers of the size of 1
        np.testing.assert_allclose(values, np.array(theirs[key], float), rtol=1e-12, atol=1e-12 * size)
    for key in ("mu", "sigma") if method == "morris" else ():
        more = [ours[factor.name].more[key] for factor in found.study.factors]
        np.testing.assert_allclose(more, np.array(theirs[key], float), rtol=1e-12, atol=1e-12 * size)


@pytest.mark.parametrize(("method", "runs"), METHODS)
def test_ishigami_has_the_indices_of_salib(method, runs):
    """To rounding."""
    assert_salib(method, results(ishigami, ISHIGAMI, method, runs))


@pytest.mark.parametrize(("method", "runs"), shards.few(METHODS[:2], METHODS, shards.search))
def test_a_stored_study_has_the_indices_of_salib(gain, tmp_path, method, runs):
    """Runs of an FMU, read from the folder of the study."""
    run(study(tmp_path, STORED.format(method=method, runs=runs), gain))
    assert_salib(method, read(tmp_path / "out"))


@SALIB
def test_indices_are_those_of_salib(choices, failed):
    """S of the mean over the combinations, T of each, both as fractions of the variance over all."""
    found = results(mixed, UNIT[:3], "saltelli", 64, choices, failed)
    data = samples(found, found.study.outputs[0])
    k = len(data.names)
    y = data.blocks(k + 2)[0].y
    ends = y.reshape(-1, k + 2, y.shape[1])[:, [0, -1]]  # A and B, of whose values SALib takes the variance

    def salib(values, key):
        settings = {"calc_second_order": False, "num_resamples": 2, "seed": 1}
        return np.array(sobol.analyze(design.problem(data.names), values, **settings)[key])

    # SALib's are fractions of the variance of the values that it is given, ours of that over all combinations
    of_mean = ends.mean(axis=2).var() / ends.var()
    first = of_mean * salib(y.mean(axis=1), "S1")
    parts = [ends[:, :, j].var() / ends.var() * salib(y[:, j], "ST") for j in range(y.shape[1])]
    ours = effects(finding(found))
    for i, name in enumerate(data.names):
        # the same sums in another order: rounding only
        assert ours[name].estimates[FIRST].value == pytest.approx(first[i], rel=1e-12, abs=1e-12)
        assert ours[name].estimates[TOTAL].value == pytest.approx(np.mean(parts, axis=0)[i], rel=1e-12)


@SALIB
def test_elementary_effects_are_those_of_salib(choices, failed):
    """Also of an unbounded factor: means over the combinations of choices, and sigma of all effects."""
    factors = (*UNIT[:2], Factor("x3", "lognormal", {"mean": 1.0, "sd": 0.3}, unit="m"))
    found = results(mixed, factors, "morris", 16, choices, failed)
    data = samples(found, found.study.outputs[0])
    of = data.blocks(len(data.names) + 1)[0]
    settings = {"num_levels": design.LEVELS, "num_resamples": 2, "seed": 1}
    each = [morris.analyze(design.problem(of.names), of.x, y, **settings) for y in of.y.T]
    star, mu, sigma = (np.array([one[key] for one in each], float) for key in ("mu_star", "mu", "sigma"))
    within, between = (sigma**2).mean(axis=0), mu.var(axis=0)
    ours = effects(finding(found))
    for i, name in enumerate(of.names):
        effect = ours[name]
        # the same sums in another order: rounding only, of effects of the size of 1
        assert effect.estimates[MU_STAR].value == pytest.approx(star.mean(axis=0)[i], rel=1e-12)
        assert effect.more["mu"] == pytest.approx(mu.mean(axis=0)[i], rel=1e-12, abs=1e-12)
        assert effect.more["sigma"] == pytest.approx(np.sqrt(within + between)[i], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("crossed", [(), (TWO,)])
def test_morris_gives_the_coefficients_of_a_linear_function(crossed: tuple[Choice, ...]) -> None:
    """mu* is the weight times the range, sigma is zero, mu has the sign, a crossed choice its difference."""

    def function(x):
        return linear(x) + 3.0 * (x["swing"] == "detailed" if crossed else 0.0)

    found = effects(finding(results(function, UNIT, "morris", 6, crossed)))
    for name, weight in (LINEAR | ({"swing": 3.0} if crossed else {})).items():
        star, more = found[name].estimates[MU_STAR].value, found[name].more
        # exact identity: rounding of differences of numbers near 10
        assert [star, more["sigma"]] == pytest.approx([abs(weight), 0.0], abs=1e-12)
        assert name == "swing" or more["mu"] == pytest.approx(weight, abs=1e-12)


def test_a_grid_has_its_analysis_of_variance() -> None:
    """First order and total of a product, by sums over the grid."""
    axes = {"a": (1.0, 2.0, 4.0), "b": (-1.0, 3.0)}
    factors = [Factor(name, "values", {"values": values}) for name, values in axes.items()]
    found = effects(finding(results(lambda x: x["a"] * x["b"], factors, "grid", 0)))
    y = np.array([[a * b for b in axes["b"]] for a in axes["a"]])
    # exact identities: rounding only
    assert found["a"].estimates[FIRST].value == pytest.approx(y.mean(axis=1).var() / y.var(), rel=1e-12)
    assert found["b"].estimates[TOTAL].value == pytest.approx(y.var(axis=1).mean() / y.var(), rel=1e-12)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_tables_of_two_grids_are_one_grid(order):
    """Each computer had some values of one factor: put together, all numbers are those of the whole."""
    halves = [Factor("x2", "values", {"values": values}, unit="m") for values in ((0.5, 2.0), (1.0,))]
    parts = [results(bent, (GRID[0], half), "grid", 0, [TWO]) for half in halves]
    table = pd.concat([parts[i].table for i in order], ignore_index=True)
    table["run"] = table.index
    both, expected = map(finding, (replace(parts[0], table=table), results(bent, GRID, "grid", 0, [TWO])))
    assert both.sensitivity.samples == expected.sensitivity.samples
    for name, effect in effects(expected).items():
        for key, estimate in effect.estimates.items():
            # exact identity but for the order of sums
            assert effects(both)[name].estimates[key].value == pytest.approx(estimate.value, rel=1e-12)


# without another choice where the groups of options make an analysis long
@pytest.mark.parametrize(
    ("method", "runs", "count"),
    [("saltelli", 16, 1), ("latin", 220, 0), ("sobol", 64, 0), ("morris", 6, 1), ("grid", 0, 1)],
)
def test_one_option_and_the_order_of_the_rows_change_nothing(method: str, runs: int, count: int) -> None:
    """A choice of one option, drawn or crossed, is none: all numbers are those of the study without it."""
    factors, others = GRID if method == "grid" else UNIT[:2], (TWO,) * count
    plain = results(bent, factors, method, runs, others)
    found = results(bent, factors, method, runs, (SINGLE[0], *others, SINGLE[1]))
    assert len(found.table) == found.study.count == len(plain.table)
    assert set(found.table[SINGLE[0].column]) == {"reach"}
    columns = [choice.column for choice in SINGLE]
    assert design.table(found.study).drop(columns=columns).equals(design.table(plain.study))
    analysis = analyse(plain)
    assert analyse(found) == analysis
    # nothing is drawn anew either: the same runs give the same indices
    shuffled = replace(plain, table=plain.table.sort_values("run", ascending=False))
    assert finding(shuffled).sensitivity == analysis.findings[0].sensitivity
