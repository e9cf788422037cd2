"""Plain samples, summaries, failed runs, and the sentences: only what the numbers support."""

import re

import numpy as np
import pytest
from kit import shards
from sweep.pages import TWO
from sweep.synthetic import ISHIGAMI, effects, every, finding, ishigami, ishigami_indices, results, uniform

from orchestrator.studies.analysis.analyse import analyse, sentences
from orchestrator.studies.analysis.results import FIRST, REGRESSION

UNIT = tuple(uniform(name, 0.0, 1.0) for name in ("x1", "x2", "x3"))


@pytest.mark.parametrize("method", ["latin", "sobol"])
def test_first_order_indices_from_a_plain_sample(method: str) -> None:
    """RBD-FAST finds those of the Ishigami function, where a linear model sees a fifth; both are told."""
    found = finding(results(ishigami, ISHIGAMI, method, 1024))
    for name, (first, _) in ishigami_indices().items():
        # 3 sd of 1024 samples; the bias of 10 harmonics is corrected to 0.01
        assert abs(effects(found)[name].estimates[FIRST].value - first) < 0.07
    # R^2 of a straight line through sin x1 + ..: corr(x1, y)^2 = 0.19
    assert found.sensitivity.quality["r_squared"] == pytest.approx(0.19, abs=0.05)


def test_a_small_sample_is_enough_if_the_function_is_linear() -> None:
    """Squared coefficients are shares, R^2 says so; of a bent function factors are not ranked."""
    found = finding(results(lambda x: 3 * x["x1"] + x["x2"], UNIT, "latin", 60))
    assert found.sensitivity.reliable
    # exact but for correlations within 60 samples, of which the sd is 0.13
    assert effects(found)["x1"].estimates[REGRESSION].value == pytest.approx(0.9, abs=0.1)
    assert found.sensitivity.quality["r_squared"] == pytest.approx(1.0, abs=1e-12)
    found = finding(results(ishigami, ISHIGAMI, "latin", 60))
    assert not found.sensitivity.reliable
    assert sentences(found)[0].startswith("The largest effect on peak cannot be found from 60 samples")


@pytest.mark.parametrize(
    ("function", "runs", "expected"),
    [
        # a factor that clearly leads is named with share, interval and direction
        (lambda x: 3 * x["x1"] - x["x2"], 256, r"x1: 9.*of its variance; it rises with it\.\nNext: x2 1"),
        # two leaders with intervals that overlap: neither is called the first
        (lambda x: x["x1"] + 1.02 * x["x2"], 64, r"x.*do not show which of them has the larger effect\.$"),
    ],
    ids=["one", "two"],
)
def test_the_sentence_names_what_leads(function, runs, expected):
    """Only as far as the numbers support it."""
    said = "\n".join(sentences(finding(results(function, UNIT, "saltelli", runs))))
    assert re.match(f"peak depends most on {expected}", said, re.MULTILINE)


def test_no_factor_stands_out_when_all_do_the_same() -> None:
    """Equal ones have no order; a product of centred factors moves its output by their being together."""
    said = sentences(finding(results(lambda x: x["x1"] + x["x2"] + x["x3"], UNIT, "saltelli", 64)))
    assert said[0].startswith("No factor stands out for peak")
    assert "2 more cannot be distinguished from it" in said[0]
    found = results(lambda x: (x["x1"] - 0.5) * (x["x2"] - 0.5), UNIT, "saltelli", 256)
    assert any("interactions" in sentence for sentence in sentences(finding(found)))


@pytest.mark.parametrize("method", ["saltelli", "latin", "morris"])
def test_a_constant_output_is_moved_by_nothing(method: str) -> None:
    """No indices are made of rounding errors."""
    found = finding(results(lambda x: 2e7 + 1e-6 * x["x1"], UNIT, method, 64))
    assert found.sensitivity is None
    runs = found.spread.runs
    assert sentences(found) == [f"peak is 200 bar in all {runs} runs: no factor has an effect on it."]


def test_summaries_are_those_of_the_runs_that_ended() -> None:
    """Quantiles over all and by option, by an independent route; failed runs count in none."""
    study = results(lambda x: x["x1"] * 1e6, UNIT, "latin", 100, [TWO], failed=every(10))
    found = finding(study)
    kept = study.table.loc[study.table["run"] % 10 != 0]
    assert found.spread.runs == len(kept) == 180
    assert found.spread.median == pytest.approx(kept["output:peak"].median(), rel=1e-12)  # rounding
    own = kept.loc[kept["choice:swing"] == "detailed", "output:peak"]
    assert found.by_choice["swing"]["detailed"].maximum == own.max()


def test_failed_runs_stand_with_reason_and_place() -> None:
    """By option, with the factor that makes runs fail; of an output that no run has, nothing is said."""

    def large(table):
        return (table["factor:x2"] > 0.9).to_numpy()

    found = analyse(results(lambda x: x["x1"], UNIT, "latin", 100, [TWO], failed=large))
    (failure,) = found.failures
    assert (failure.reason, failure.count) == ("state became inf at 0.4 s", 20)
    assert failure.by_choice == {"swing": {"lumped": 10, "detailed": 10}}
    assert found.notes == ("runs fail more often at large x2",)
    found = finding(results(lambda x: x["x1"], UNIT, "latin", 20, failed=every(1)))
    assert sentences(found) == ["No run has peak."]


def test_points_of_sobol_do_not_lend_one_factor_the_effect_of_another() -> None:
    """Sobol's g-function in a sample where plain RBD-FAST gives x2 0.43 of the variance; it moves 0.024."""
    weights = np.array([0.0, 1.0, 4.5, 9.0, 99.0, 99.0])
    factors = [uniform(f"x{i}", 0.0, 1.0) for i in range(6)]

    def g(x):
        return np.prod([(abs(4 * x[f"x{i}"] - 2) + a) / (1 + a) for i, a in enumerate(weights)], axis=0)

    found = effects(finding(results(g, factors, "sobol", 512, seed=36)))
    parts = 1 / (3 * (1 + weights) ** 2)  # variances of the product's terms
    truth = parts / (np.prod(1 + parts) - 1)
    for i, share in enumerate(truth):
        estimate = found[f"x{i}"].estimates[FIRST]
        # over 40 seeds the errors have a mean of -0.02 and a standard deviation of 0.01
        assert estimate.value == pytest.approx(share, abs=0.06)
        assert estimate.floor <= share <= estimate.ceiling


@shards.search
def test_intervals_of_a_linear_model_hold_the_share() -> None:
    """Also where the model is exact: of 20 samples at least 17 (at 95 %, fewer in 1 of 60)."""
    truth = np.array([1.0, 4.0, 9.0]) / 14.0
    held = np.zeros(3)
    for seed in range(20):
        found = results(lambda x: x["x1"] + 2 * x["x2"] + 3 * x["x3"], UNIT, "latin", 100, seed=seed)
        shares = [effects(finding(found))[f.name].estimates[REGRESSION] for f in UNIT]
        held += [s.floor <= t <= s.ceiling for s, t in zip(shares, truth, strict=True)]
    assert (held >= 17).all()


@pytest.mark.parametrize(
    ("function", "factors", "total"),
    [
        # two centred factors: nothing alone, each in everything
        (lambda x: (x["x1"] - 0.5) * (x["x2"] - 0.5), UNIT[:2], 200),
        # three: each in everything
        (lambda x: (x["x1"] - 0.5) * (x["x2"] - 0.5) * (x["x3"] - 0.5), UNIT, 300),
        # 1 + the share of x1 x3, which counts twice: 0.244 [Saltelli et al. 2008, section 4.7]
        (ishigami, ISHIGAMI, 124),
    ],
    ids=["two", "three", "ishigami"],
)
def test_shares_of_a_sentence_sum_to_at_most_everything(function, factors, total) -> None:
    """Total indices, which sum to more, are in a sentence that says so."""
    said = sentences(finding(results(function, factors, "saltelli", 512)))
    percent = re.compile(r"(\d+) % \(")
    shares = " ".join(s for s in said if "depends most" in s or s.startswith(("Next", "No factor")))
    # noise of 512 base samples, 0.03 for each factor
    assert sum(map(int, percent.findall(shares))) <= 109
    # three deviations of such a sum of total indices, 0.05
    (overlapping,) = (s for s in said if s.startswith("With all interactions: "))
    assert sum(map(int, percent.findall(overlapping))) == pytest.approx(total, abs=15)
    assert overlapping.endswith("; these overlap, so they sum to more than 100 %.")
