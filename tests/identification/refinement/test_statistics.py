"""Uncertainty of the refinement: intervals, unidentified parameters, residual analysis."""

import math
from dataclasses import replace

import numpy as np
import pytest
from identification.procedures.bench import changed
from identification.refinement.oscillator import NOISE, TRUTH, problem, recording, run
from scipy.optimize import least_squares
from scipy.signal import lfilter

from fmus.identification.recordings.masks import noise
from fmus.identification.refinement import statistics
from fmus.identification.refinement.problem import FreeParameter, moves_at_start, smoothed
from fmus.identification.refinement.refine import RefinementResult, compiled, cut_into_segments, refine
from fmus.identification.refinement.shooting import CondensedRun, correlation_time
from fmus.identification.results import Estimate, coverage_factor


@pytest.fixture(scope="module")
def refined() -> RefinementResult:
    """The right model, fitted to a recording with white noise."""
    return refine(problem(run(recording())))


def test_intervals_cover_the_truth() -> None:
    """Over 40 seeds of the noise, 95 % intervals cover the truth in 95 % of cases, by both covariances."""
    task = problem(run(recording()))
    model, truth = compiled(task), np.log([TRUTH[name] for name in task.names])
    inside = {False: 0, True: 0}
    for seed in range(40):
        found = refine(problem(run(recording(seed))), model)
        for robust in inside:
            half = coverage_factor(found.statistics.degrees(robust)) * found.statistics.sd(robust)
            inside[robust] += int(np.sum(np.abs(found.z - truth) <= half))
    # 120 intervals, some of them correlated: 108 and less has a chance below 1 % at 95 %; a jackknife over
    # six segments errs to the safe side
    assert 109 <= inside[False] <= 119
    assert 109 <= inside[True] <= 120


def test_optimum_and_covariance_are_those_of_scipy(refined: RefinementResult) -> None:
    """An independent search over parameters and initial state has the same optimum and covariance."""
    found, model, one = refined, compiled(refined.problem, 1e-9), refined.problem.training[0]
    inputs = np.column_stack([one.inputs[n] for n in model.inputs])

    def residuals(unknown: np.ndarray) -> np.ndarray:
        y = model.segment(unknown[:2], np.exp(unknown[2:]), one.time, inputs, False).y
        weighted = (y - one.measured)[:, 0] * one.weight[:, 0]
        # speed at the start is 0 +- 1e-3 of its nominal value, 3 m/s; position is what the data say
        return np.append(weighted, unknown[1] / 3e-3)

    other = least_squares(residuals, np.concatenate([[0.0, 0.0], found.z]), x_scale=0.01, xtol=1e-12)
    free = len(one.time) - 5
    covariance = np.linalg.inv(other.jac.T @ other.jac) * 2 * other.cost / free
    # two start states and three parameters; the noise is white, so every sample counts
    assert (found.statistics.degrees_of_freedom, found.statistics.segments) == (free, 6)
    sd = found.statistics.sd(False)
    # the search ends within a tenth of a standard deviation, usually far within
    assert np.max(np.abs(found.z - other.x[2:]) / sd) < 0.1
    # difference quotients, the weak prior, and one sample more or less: some per mille
    np.testing.assert_allclose(sd, np.sqrt(np.diag(covariance))[2:], rtol=0.01)


PAIR = ("stiffness", "damping", "gain", "loss")  # gain and loss act only as a ratio


def test_unidentifiable_pair_is_named(refined: RefinementResult) -> None:
    """The sentence says that only the ratio is determined, and the other parameters are estimated."""
    found = refine(problem(run(recording()), free=PAIR))
    assert found.unidentified == ("gain and loss: the data determine only gain / loss, not each parameter",)
    ratio = found.values["gain"] / found.values["loss"]
    # five standard deviations of about 0.5 %
    assert ratio == pytest.approx(TRUTH["gain"] / TRUTH["loss"], rel=0.025)
    assert found.statistics.condition > 1e6
    # a prior of 100 on each, which both share along their ratio: rounding of the information
    assert found.statistics.sd(False)[2:] == pytest.approx(np.full(2, 100 / np.sqrt(2)), rel=1e-3)
    assert refined.unidentified == ()


def test_prior_decides_where_the_data_are_silent() -> None:
    """With a prior on one of the pair both are estimated, that one with the prior's standard deviation."""
    found = refine(problem(run(recording()), free=PAIR, priors={"loss": (1.0, 0.1)}))
    assert not found.robust
    loss = found.estimates()[3]
    # the data add nothing: prior to rounding of the information
    assert (loss.value, loss.sd) == (pytest.approx(1.0, abs=1e-3), pytest.approx(0.1, rel=1e-2))
    assert found.unidentified  # the sentences are about the data alone


def test_what_was_known_before_bounds_what_the_data_leave_open() -> None:
    """The interval of a parameter that the data do not determine is that of its prior."""
    open_, bounded = (
        statistics.unidentified((FreeParameter("loss", 1.0, sd=sd, log=True),), np.array([[0.6]]))[0]
        for sd in (None, 0.1)
    )
    told = "leave a standard deviation of 77 %"  # the root of 0.6
    assert open_ == f"loss: the data {told}"
    assert bounded.startswith(f"loss: these recordings alone {told}; the interval is")


@pytest.mark.parametrize(("share", "named"), [(0.03, "gain: "), (0.1, "gain and loss: ")])
def test_a_parameter_that_hardly_takes_part_is_not_named(share, named) -> None:
    """A direction without data whose square is 3 % or 10 % along the second parameter."""
    direction = np.sqrt([1 - share, share])
    free = (FreeParameter("gain", 1.0, log=True), FreeParameter("loss", 1.0, log=True))
    (sentence,) = statistics.unidentified(free, 1e-4 * np.eye(2) + 1e4 * np.outer(direction, direction))
    assert sentence.startswith(named)


def test_residuals_are_white_only_if_the_model_is_right(refined: RefinementResult) -> None:
    """With a wrong gain, residuals are correlated in time."""
    right = refined.whiteness["position"]
    assert right.white
    fixed = problem(run(recording()), free=("stiffness", "damping"))
    numbers = replace(fixed.fixed, p={**TRUTH, "gain": 3.0})
    wrong = refine(replace(fixed, fixed=numbers))
    tests = wrong.whiteness["position"]
    assert not tests.white
    assert wrong.robust
    assert wrong.model_error[0] > 5


def test_the_error_of_an_estimated_noise() -> None:
    """The scatter of 400 estimates from 1000 samples each, known to 1 / sqrt(800) = 3.5 %."""
    rng = np.random.default_rng(0)
    found = np.std([noise(rng.standard_normal(1000)) for _ in range(400)])
    assert found * np.sqrt(1000) == pytest.approx(statistics.NOISE_ERROR, rel=0.1)


@pytest.mark.parametrize(
    ("made", "low", "high"),
    [
        (lambda n: n, 0.35, 0.55),
        (lambda n: 4 * n, 0.35, 0.55),  # a noise stated too small is no error of the model
        (lambda n: np.sqrt(12) * (np.round(n.cumsum() / 9) - n.cumsum() / 9), 0.35, 0.55),  # slow steps of 1
        (lambda n: n + 0.8 * np.sin(np.arange(n.size) / 50), 0.0, 1e-6),
    ],
)
def test_residuals_above_their_noise_are_improbable(made, low, high) -> None:
    """Noise: p is uniform where there is an excess; an oscillation of 0.8 standard deviations: no noise."""
    rng = np.random.default_rng(0)
    p = [statistics.excess(made(rng.standard_normal(2000))) for _ in range(150)]
    # the standard deviation of a quantile of 150 uniform numbers is 0.04
    assert low <= np.quantile(p, 0.45) <= high


def test_whiteness_does_not_see_across_gaps() -> None:
    """White residuals with half the samples masked are white; with too few samples there is no result."""
    task = problem(run(recording()))
    one = task.training[0]
    rng = np.random.default_rng(3)
    traces = statistics.SimulatedRun(one, one.measured + NOISE * rng.standard_normal(one.measured.shape))
    holes = rng.random(one.weight.shape) < 0.5
    half = replace(one, weight=np.where(holes, 0.0, one.weight))
    assert statistics.whiteness([replace(traces, run=half)], 0).white
    for samples in (150, 170):  # four times 40 lags are needed
        few = replace(one, weight=one.weight * (np.arange(601) < samples)[:, None])
        found = statistics.whiteness([replace(traces, run=few)], 0)
        assert np.isnan(found.outside) == (samples < 160)


def test_bands_hold_the_readings_to_come() -> None:
    """95 % of the samples of a held-out run are in its bands, which are wider than noise alone makes them."""
    shares, wider = [], []
    for seed in range(12):
        task = problem(run(recording(seed, seconds=3.0)), held_out=(run(recording(seed + 100)),))
        found = refine(task)
        (held_out,) = found.held_out
        _, sd = found.uncertainty(held_out.run)
        shares.append(np.mean(np.abs(held_out.error) < 1.96 * sd))
        wider.append(sd.max() / NOISE)
    # the samples of a run share the error of its parameters: the mean of 12 runs is known to some percent
    assert 0.91 < np.mean(shares) < 0.98
    assert np.mean(wider) > 1.2


def test_sensitivities_are_those_of_a_repeated_simulation(refined: RefinementResult) -> None:
    """Central differences of the prediction by z, also by an initial state that comes from a parameter."""
    one, step = refined.problem.training[0], 1e-4
    by_z, _ = refined.uncertainty(one)
    for j in range(len(refined.z)):
        moved = (refined.z + sign * step * np.eye(3)[j] for sign in (1, -1))
        values = (refined.problem.values_of(z) for z in moved)
        ends = [statistics.simulate(one, refined.simulator, v).y for v in values]
        # the solver's tolerance over the step
        np.testing.assert_allclose(by_z[:, :, j], (ends[0] - ends[1]) / (2 * step), atol=1e-2)


def test_noise_of_an_input_is_removed() -> None:
    """A noisy constant becomes constant; an oscillation faster than the window is not removed."""
    time = np.arange(2000) / 200
    noise = 0.1 * np.random.default_rng(0).standard_normal(2000)
    still, window = smoothed(time, 5 + noise, 8.0, 0.1)
    assert window > 1000
    assert np.std(still) < 0.02  # 0.1 over the root of 1600 samples, three times that at the ends
    wave = np.sin(2 * np.pi * time)
    moving, window = smoothed(time, wave + noise, 8.0, 0.1)
    assert 5 <= window < 200
    assert np.std(moving - wave) < 0.07


@pytest.mark.parametrize(
    ("size", "seconds", "removed"), [(1.05, 10, True), (1.15, 10, False), (1.3, 1, True), (1.5, 1, False)]
)
def test_a_window_may_remove_no_more_than_noise(size, seconds, removed) -> None:
    """Of noise 1, mean squares up to 1 + 3 sqrt(2 / 2000) of ten seconds, 1 + 4 sqrt(2 / 199) of each."""
    time = np.arange(2000) / 200
    signal = np.sqrt(size) * (-1.0) ** np.arange(2000) * (time < seconds)  # parabolas remove all of it
    assert (smoothed(time, signal, 2.0, 1.0)[1] > 100) == removed


def test_a_slope_of_five_standard_deviations_is_motion() -> None:
    """Of six samples in a tenth of a second: the slope has the standard deviation sd / root of sum t^2."""
    made, sd = recording(), NOISE / np.sqrt(np.sum((np.arange(6) / 50 - 0.05) ** 2))
    moves = [moves_at_start(changed(made, {"position": k * sd * made.time}), "position") for k in (4, 6)]
    assert moves == [False, True]


def test_the_start_of_a_run_is_known_at_rest_only() -> None:
    """A prior of a nominal value, of a thousandth at rest; a speed is a slope of five samples."""
    task = problem(run(recording()))
    prior = cut_into_segments(task, compiled(task), task.initial()).start_prior(0, np.zeros(2))
    assert prior[:, :2].tolist() == [[1.0, 0.0], [0.0, 1000.0]]
    exact, noisy = (run(recording(noise=n)).measured_states["speed"] for n in (0.0, NOISE))
    # a parabola over five samples: the sum of the squares of -2 to 2 is ten; 600 samples, 5 of which depend
    assert np.std(noisy - exact) == pytest.approx(NOISE * 50 / np.sqrt(10), rel=0.15)


def test_correlation_time_of_an_autoregressive_process() -> None:
    """For x_k = a x_(k-1) + e_k it is (1 + a) / (1 - a); at least one, at most a fraction of the samples."""
    rng = np.random.default_rng(5)
    white = rng.standard_normal(100_000)
    for a in (0.0, 0.5, 0.9):
        # 10 %: some thousand independent stretches, cut off where the noise of the sum begins
        assert correlation_time(lfilter([1], [1, -a], white)) == pytest.approx((1 + a) / (1 - a), rel=0.1)
    assert correlation_time(np.linspace(-1, 1, 1000)) == pytest.approx(50)  # a trend: a twentieth
    assert correlation_time(np.zeros(1000)) == 1


def test_leaving_out_one_segment_after_another_gives_the_variance_of_a_mean() -> None:
    """For one sample per segment and their mean as unknown, the jackknife is s^2 / n with n - 1 degrees."""
    samples = np.random.default_rng(4).normal(size=7)
    rows = [np.array([[1.0, sample - samples.mean()]]) for sample in samples]
    run = CondensedRun([], rows, np.zeros((0, 2)), np.vstack(rows))
    found = statistics._jackknife([run], np.zeros((1, 1)), np.array([[1 / 7]]))
    # exact identity: rounding only
    assert found[0, 0] == pytest.approx(np.var(samples, ddof=1) / 7, rel=1e-12, abs=0)


# ---- intervals of an estimate: width, shape and bounds


def ends(value: float, sd: float, *freedom: float, **shape: object) -> tuple[float, float]:
    """The interval of a value."""
    estimate = Estimate.normal("mass", value, "kg", sd, "by hand", *freedom, **shape)
    return estimate.low, estimate.high


@pytest.mark.parametrize(
    ("freedom", "factor"), [(math.inf, 1.959964), (1, 12.7062), (4, 2.77645), (30, 2.04227)]
)
def test_an_interval_is_that_of_tables(freedom, factor):
    """The 97.5 % quantile of the normal distribution, and of Student's t for few degrees of freedom."""
    # tables have six digits
    assert coverage_factor(freedom) == pytest.approx(factor, rel=1e-5)
    assert ends(5.0, 2.0, freedom) == pytest.approx((5 - 2 * factor, 5 + 2 * factor), abs=2e-4)


def test_logarithmic_cut_and_open_intervals():
    """A positive value times and over a factor; bounds cut it; an unknown error leaves it open."""
    low, high = ends(2.0, 1.0, log=True)
    # exact identity: rounding only
    assert (low * high, high / 2.0) == pytest.approx((4.0, math.exp(coverage_factor() / 2)))
    assert ends(-2.0, 1.0, log=True) == ends(-2.0, 1.0)
    assert ends(1.0, 1.0, minimum=0.0) == (0.0, ends(1.0, 1.0)[1])
    assert ends(1.0, math.inf) == (-math.inf, math.inf)
    note = Estimate.normal("mass", 1.0, "kg", math.inf, "by hand", minimum=0.0).number().note
    assert note == "by hand; 95 % interval 0 to open"
