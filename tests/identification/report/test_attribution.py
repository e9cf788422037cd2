"""Which effect a residual shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from fmus.identification.machine import COMMANDS
from fmus.identification.report.attribution import (
    EFFECTS,
    LEAST,
    effect_changes,
    explain,
    explained_squares,
    orthogonal_part,
    sensitivities,
    shapley_values,
)
from fmus.identification.report.prediction import Excitation
from fmus.machine.work_cycle import Move

STEP = 0.01  # s
# every joint moves and stops again: each effect shows in a few seconds
MOVES = {
    "swing_command": Move("swing", 0.5, 3.0, 0.3, 0.8, 0.3),
    "boom_command": Move("boom", 0.3, 3.0, 0.2, 0.6, 0.2),
    "stick_command": Move("stick", 1.0, -3.0, 0.2, 0.8, 0.2),
}
DAMPING = "manipulator.swing_damping"


@pytest.fixture(scope="module")
def drive():
    """Four seconds of all joints."""
    time = np.arange(400) * STEP
    commands = {name: MOVES[name].sample(time) for name in COMMANDS}
    return Excitation(time, commands, {"swing": 0.0, "boom": 0.2, "stick": -1.4})


@pytest.fixture(scope="module")
def effects(drive):
    """What each effect changes in angles, pressures and flows."""
    shown = ("angle", "pressure", "pressure_a", "pressure_b", "flow_a", "head_flow")
    return {
        effect: {
            name: y for name, y in change.items() if name.rsplit("_", 1)[-1] in shown or name.endswith(shown)
        }
        for effect, change in effect_changes(drive, {}).items()
    }


def noisy(change, share, seed=0):
    """A residual of one effect, plus white noise of this share of each signal's size."""
    rng = np.random.default_rng(seed)
    moved = {n: y for n, y in change.items() if np.std(y) > 0}
    return {n: y + share * np.sqrt(np.mean(y**2)) * rng.standard_normal(y.size) for n, y in moved.items()}


@pytest.mark.parametrize("effect", EFFECTS)
def test_the_effect_that_made_the_residual_is_named(effects, effect):
    """One effect plus as much noise: it is named, at its strength, and its share is that of the effect."""
    found = explain(noisy(effects[effect], 1.0), effects, step=STEP)
    assert found.effect == effect
    assert effect in found.verdict
    share = found.shares[0]
    # signals count by their residuals: half of each is noise, over 400 samples known to some percent
    assert share.alone == pytest.approx(0.5, abs=0.08)
    # standard deviation of the strength: noise over signal over root of samples, 1 / sqrt(400 * 10)
    assert share.coefficient == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("effect", EFFECTS)
def test_twice_the_effect_is_twice_as_strong(effects, effect):
    """The strength counts how much of the variant's effect is there."""
    doubled = {n: 2 * y for n, y in effects[effect].items() if np.std(y) > 0}
    # exact identity: rounding only
    assert explain(doubled, effects, step=STEP).shares[0].coefficient == pytest.approx(2.0, rel=1e-9)


def test_white_noise_shows_no_effect(effects):
    """Noise in all signals: nothing is named, and the page says that nothing explains it."""
    rng = np.random.default_rng(1)
    noise = {n: rng.standard_normal(y.size) for n, y in effects["swinging head"].items()}
    found = explain(noise, effects, step=STEP)
    assert found.effect == ""
    assert found.verdict.startswith("None of the effects")
    assert "a cause that is not in the list" in found.verdict  # nobody said that it is noise
    # five columns explain five of some thousand samples by chance
    assert found.together < 0.02


def test_a_residual_within_the_noise_of_the_sensors_is_left_out(effects):
    """A signal whose residual is as large as its sensor's noise is quiet; if all are, nothing is told."""
    change = effects["swinging head"]
    residual = noisy(change, 0.0)
    size = {n: float(np.sqrt(np.mean(y**2))) for n, y in residual.items()}
    found = explain(residual, effects, step=STEP, noise=size)
    assert found.quiet == tuple(residual)
    assert (found.effect, found.shares) == ("", ())
    assert found.verdict.startswith("Nothing is left to explain")
    assert "range" not in found.verdict


def test_a_small_residual_needs_no_effect(effects):
    """Far above perfect sensors, but below what matters: the prediction is called as good as that."""
    residual = noisy(effects["swinging head"], 0.0)
    found = explain(residual, effects, step=STEP, small=dict.fromkeys(residual, np.inf))
    assert (found.effect, found.shares) == ("", ())
    assert "0.1 % of its range" in found.verdict


def test_what_parameters_can_take_is_no_effect(drive, effects):
    """A wrong damping is a wrong damping: its residual goes to the parameters."""
    given_ = {DAMPING: 300.0}
    slope = sensitivities(drive, given_, [DAMPING])
    found = explain(noisy(slope[DAMPING], 0.1), effects, step=STEP, absorbed=slope)
    assert found.effect == ""
    # noise is a hundredth of the power, and the damping explains the rest
    assert found.parameters == pytest.approx(0.99, abs=0.01)


def test_an_effect_is_named_beside_the_parameters(drive, effects):
    """Dry friction looks like damping in part; what is left of it still shows."""
    slope = sensitivities(drive, {DAMPING: 300.0}, [DAMPING])
    residual = noisy(effects["dry friction"], 0.2)
    found = explain(residual, effects, step=STEP, absorbed=slope)
    assert found.effect == "dry friction"
    assert found.shares[0].alone + found.parameters < 1.0


def test_gaps_do_not_count(effects):
    """Samples without a measurement are left out of everything."""
    residual = noisy(effects["pump and engine"], 0.0)
    cut = {n: np.where(np.arange(y.size) < 200, np.nan, y) for n, y in residual.items()}
    found = explain(cut, effects, step=STEP)
    assert found.effect == "pump and engine"
    # exact identity: without noise the effect explains all that is left
    assert found.shares[0].alone == pytest.approx(1.0, abs=1e-9)


@given(
    st.integers(1, 4).flatmap(
        lambda m: st.tuples(st.just(m), st.integers(0, 2**31 - 1), st.floats(1e-6, 1e6))
    )
)
@examples(30)
def test_shares_add_up(case):
    """Shapley values of any columns add up to what all explain together, whatever their scale."""
    count, seed, scale = case
    rng = np.random.default_rng(seed)
    d, r = rng.standard_normal((60, count)), rng.standard_normal(60)
    part = explained_squares(d, r)
    # exact identity: rounding only
    assert sum(shapley_values(part, count)) == pytest.approx(part[-1], abs=1e-9)
    np.testing.assert_allclose(explained_squares(scale * d, r), part, atol=1e-9 * float(r @ r))


def test_two_equal_effects_share(effects):
    """Two effects that nobody can tell apart explain the same alone and half of it each among all."""
    change = effects["swinging head"]
    found = explain(noisy(change, 0.0), {"one": change, "other": change}, step=STEP)
    # exact identity: rounding only
    assert [s.alone for s in found.shares] == pytest.approx([1.0, 1.0])
    assert [s.together for s in found.shares] == pytest.approx([0.5, 0.5])
    assert "hardly distinguish it from" in found.verdict


def test_columns_without_others_are_orthogonal_to_them():
    """What is left beside other columns has no part along them, even if these depend on each other."""
    rng = np.random.default_rng(3)
    slope = rng.standard_normal((50, 3))
    slope = np.column_stack([slope, slope[:, 0] - slope[:, 1], np.zeros(50)])
    left = orthogonal_part(rng.standard_normal(50), slope)
    # exact identity: rounding only
    np.testing.assert_allclose(slope.T @ left, 0, atol=1e-12)


def test_the_least_share_is_told(effects):
    """An effect with less than the least share is not named, however significant it is."""
    residual = noisy(effects["swinging head"], 2.5)  # 1 / (1 + 2.5^2) = 0.14 of the power
    found = explain(residual, effects, step=STEP)
    assert found.shares[0].effect == "swinging head"
    assert 0.05 < found.shares[0].alone < LEAST
    assert found.effect == ""
