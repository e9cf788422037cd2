"""Attribution of a residual to physical effects."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmus.identification.machine import COMMANDS
from fmus.identification.report import attribution
from fmus.identification.report.prediction import Excitation, compare, predict
from fmus.operator_input.work_cycle import Move
from orchestrator.data.recording import Recording

STEP = 0.01  # s
# every joint moves and stops again: each effect shows in a few seconds
MOVES = {
    "swing_command": Move("swing", 0.5, 3.0, 0.3, 0.8, 0.3),
    "boom_command": Move("boom", 0.3, 3.0, 0.2, 0.6, 0.2),
    "stick_command": Move("stick", 1.0, -3.0, 0.2, 0.8, 0.2),
}
DAMPING = "manipulator.swing_damping"


@pytest.fixture(scope="module")
def excitation():
    """Four seconds of all joints."""
    time = np.arange(400) * STEP
    commands = {name: MOVES[name].sample(time) for name in COMMANDS}
    return Excitation(time, commands, {"swing": 0.0, "boom": 0.2, "stick": -1.4})


@pytest.fixture(scope="module")
def default(excitation):
    """What the machine does."""
    return predict(excitation, {})


@pytest.fixture(scope="module")
def effects(excitation):
    """Change of angles, pressures and flows by each effect."""
    signals = ("angle", "pressure", "pressure_a", "pressure_b", "flow_a", "head_flow")
    changes = attribution.effect_changes(excitation, {})
    return {e: {n: y for n, y in change.items() if n.endswith(signals)} for e, change in changes.items()}


def noisy(change, share, seed=0):
    """A residual of one effect plus white noise, relative to the rms of each signal."""
    rng = np.random.default_rng(seed)
    moved = {n: y for n, y in change.items() if np.std(y) > 0}
    return {n: y + share * np.sqrt(np.mean(y**2)) * rng.standard_normal(y.size) for n, y in moved.items()}


@pytest.mark.parametrize("effect", [*attribution.EFFECTS, attribution.LATE, attribution.EARLY])
def test_the_effect_in_the_residual_is_identified(effects, effect):
    """One effect plus as much noise: its name, its share and its strength are right."""
    explanation = attribution.explain(noisy(effects[effect], 1.0), effects, step=STEP)
    assert explanation.effect == effect
    assert effect in explanation.verdict
    share = explanation.shares[0]
    # signals count by their residuals: half of each is noise, over 400 samples known to some percent
    assert share.alone == pytest.approx(0.5, abs=0.08)
    # standard deviation of the strength: noise over signal over root of samples, 1 / sqrt(400 * 10)
    assert share.coefficient == pytest.approx(1.0, abs=0.06)
    doubled = {n: 2 * y for n, y in effects[effect].items() if np.std(y) > 0}
    share = attribution.explain(doubled, effects, step=STEP).shares[0]
    assert share.coefficient == pytest.approx(2.0, rel=1e-9)  # exact identity: rounding only


def test_white_noise_shows_no_effect(effects):
    """Noise in all signals: no effect, and the verdict says that none explains it."""
    rng = np.random.default_rng(1)
    noise = {n: rng.standard_normal(y.size) for n, y in effects["swinging head"].items()}
    explanation = attribution.explain(noise, effects, step=STEP)
    assert explanation.effect == ""
    assert explanation.verdict.startswith("None of the effects")
    assert "a cause that is not in the list" in explanation.verdict  # the noise of the sensors is not given
    # seven columns explain seven of some thousand samples by chance
    assert explanation.together < 0.02


def test_an_interval_counts_half_a_second_of_correlation():
    """Newey and West: the covariance of the products with lags up to 0.5 s, each with a smaller weight."""
    rng = np.random.default_rng(0)
    change, error = (np.convolve(rng.standard_normal(1000), np.ones(30), "same") for _ in range(2))
    share = attribution.explain({"x": change + error}, {"swinging head": {"x": change}}, step=STEP).shares[0]
    product = change * (change + error - share.coefficient * change)
    lags = [(1 - k / 51) * product[k:] @ product[: product.size - k] for k in range(51)]
    sd = np.sqrt(2 * sum(lags) - lags[0]) / (change @ change)
    # the same sum in another order, with the factor n / (n - 1) for one coefficient at most
    assert share.high - share.low == pytest.approx(2 * 1.959964 * sd, rel=1e-3)


@pytest.mark.parametrize("ratio", [1.4, 1.6])
def test_a_signal_is_above_the_noise_from_one_and_a_half_times_on(ratio):
    """A residual of that size of a sensor of noise one."""
    assert attribution.unexplained({"x": np.full(9, ratio)}, {"x": 1.0}, {}) == ["x"] * (ratio > 1.5)


@pytest.mark.parametrize("why", ["noise", "small"])
def test_a_small_residual_is_left_out(effects, why):
    """A residual as large as the sensor's noise, or small for the signal's range, needs no explanation."""
    residual = noisy(effects["swinging head"], 0.0)
    size = {n: float(np.sqrt(np.mean(y**2))) for n, y in residual.items()}
    limits = {"noise": size} if why == "noise" else {"small": dict.fromkeys(residual, np.inf)}
    explanation = attribution.explain(residual, effects, step=STEP, **limits)
    assert explanation.quiet == tuple(residual)
    assert (explanation.effect, explanation.shares) == ("", ())
    assert explanation.verdict.startswith("Nothing is left to explain")
    assert ("0.1 % of its range" in explanation.verdict) == (why == "small")
    assert ("range" in explanation.verdict) == (why == "small")


def test_without_an_unexplained_residual_no_effect_is_simulated(excitation, monkeypatch):
    """The simulations of effects and parameters, most of the time of `identify`, are left out."""
    name = "manipulator.boom_angle"
    recording = Recording(excitation.time, {name: excitation.time}, {name: "rad"}, Path("a.csv"))
    monkeypatch.delattr(attribution, "effect_changes")
    assert attribution.attribute(compare(recording, dict(recording.signals)), {}).shares == ()


def test_parameters_and_an_effect_are_told_apart(excitation, default, effects):
    """A wrong damping is one of parameters; dry friction is found, although it resembles damping."""
    damped = predict(excitation, {DAMPING: 300.0 * 1.001})
    slope = {DAMPING: {n: damped[n] - y for n, y in default.items()}}
    explanation = attribution.explain(noisy(slope[DAMPING], 0.1), effects, step=STEP, absorbed=slope)
    assert explanation.effect == ""
    # noise is a hundredth of the power, and the damping explains the rest
    assert explanation.parameters == pytest.approx(0.99, abs=0.01)
    residual = noisy(effects["dry friction"], 0.2)
    explanation = attribution.explain(residual, effects, step=STEP, absorbed=slope)
    assert explanation.effect == "dry friction"
    assert explanation.shares[0].alone + explanation.parameters < 1.0


@pytest.mark.parametrize("delay", [0.01, -0.015])
def test_commands_at_another_time_are_named_with_their_delay(excitation, default, effects, delay):
    """The machine acts on the commands of other times."""
    moved = {n: MOVES[n].sample(excitation.time - delay) for n in COMMANDS}
    then = predict(replace(excitation, commands=moved), {})
    residual = {n: then[n] - default[n] for n in effects[attribution.LATE]}
    explanation = attribution.explain(noisy(residual, 0.1), effects, step=STEP)
    assert explanation.effect == (attribution.LATE if delay > 0 else attribution.EARLY)
    told = float(re.search(r"`delay = (\S+)` at each command", explanation.verdict)[1])
    assert "With `delay_error = 0.1` in its place" in explanation.verdict
    # linear in the delay, to a fifth
    assert told == pytest.approx(delay, rel=0.2)


def test_gaps_do_not_count(effects):
    """Samples without a measurement are left out."""
    residual = noisy(effects["pump and engine"], 0.0)
    cut = {n: np.where(np.arange(y.size) < 200, np.nan, y) for n, y in residual.items()}
    explanation = attribution.explain(cut, effects, step=STEP)
    assert explanation.effect == "pump and engine"
    # exact identity: without noise the effect explains the whole residual
    assert explanation.shares[0].alone == pytest.approx(1.0, abs=1e-9)


def test_two_equal_effects_share(effects):
    """Two equal effects explain the same alone, and no more together."""
    change = effects["swinging head"]
    explanation = attribution.explain(noisy(change, 0.0), {"one": change, "other": change}, step=STEP)
    # exact identity: rounding only
    assert [s.alone for s in explanation.shares] == pytest.approx([1.0, 1.0])
    assert explanation.together == pytest.approx(1.0)
    assert "hardly distinguish it from" in explanation.verdict


def test_a_small_share_is_not_reported(effects):
    """An effect with less than the smallest share is not reported, even if it is significant."""
    residual = noisy(effects["swinging head"], 2.5)  # 1 / (1 + 2.5^2) = 0.14 of the power
    explanation = attribution.explain(residual, effects, step=STEP)
    assert explanation.shares[0].effect == "swinging head"
    assert 0.05 < explanation.shares[0].alone < attribution.LEAST
    assert explanation.effect == ""
