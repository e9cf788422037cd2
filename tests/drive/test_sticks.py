"""From deflections to commands: curve, patterns, modes."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from view.standin import CONTROLLER, DESCRIPTION, LEVERS, MODES

from orchestrator.drive.sticks import StickAxes, commands, functions, legend, modes, response

DEFLECTIONS = st.floats(-1, 1)
PATTERNS, WORDS = DESCRIPTION.patterns, DESCRIPTION.functions
# the function that a stick to the right, or away from the operator, moves; in its negative direction
SIDES = {
    "ISO": {"left_x": "swing", "left_y": "stick", "right_x": "curl", "right_y": "boom"},
    "SAE": {"left_x": "swing", "left_y": "boom", "right_x": "curl", "right_y": "stick"},
}


@given(DEFLECTIONS, DEFLECTIONS)
def test_curve_is_odd_bounded_and_never_falls(a: float, b: float) -> None:
    """Both directions are the same, no deflection is more than full speed, a larger one never less."""
    assert response(-a) == -response(a)
    assert abs(response(a)) <= 1
    low, high = sorted((a, b))
    # the cubic of numbers a rounding error apart may be a rounding error out of order
    assert response(low) <= response(high) + 1e-15


def test_curve_by_hand() -> None:
    """Nothing in the dead zone of 0.08, half-way beyond it 0.4 * 0.5 + 0.6 * 0.125, all at the stop."""
    assert response(0.08) == 0
    # exact identities up to rounding
    assert response(0.54) == pytest.approx(0.275, rel=1e-14)
    assert response(1.0) == pytest.approx(1, rel=1e-14)
    assert response(1e9) == response(1.0)
    assert response(float("nan")) == 0


@pytest.mark.parametrize("name", PATTERNS)
def test_patterns(name: str) -> None:
    """Each axis moves the one function that ISO 10968 and SAE J1814 give it, in their direction."""
    for axis, which in SIDES[name].items():
        found = functions(StickAxes(**{axis: 1.0}), PATTERNS[name])
        assert found == dict.fromkeys(WORDS, 0.0) | {which: -1.0}, axis


@pytest.mark.parametrize("mode", ["levers", "tip"])
@pytest.mark.parametrize("name", PATTERNS)
def test_legend_says_what_happens(name: str, mode: str) -> None:
    """The words beside a stick name the function that moves, in the direction that it moves."""
    words = legend(PATTERNS[name], WORDS, MODES[mode])
    ends = {"left": ("x", -1), "right": ("x", 1), "up": ("y", 1), "down": ("y", -1)}
    positive = {"swing": "left", "boom": "up", "stick": "in"}
    for place, text in words.items():
        hand, end = place.split("_")
        axis, sign = ends[end]
        found = functions(StickAxes(**{f"{hand}_{axis}": float(sign)}), PATTERNS[name])
        if found["curl"]:
            assert text == ""
            continue
        which = next(f for f in positive if found[f])
        assert text.endswith(f" {positive[which]}") == (found[which] > 0)
        assert text.startswith(which if mode == "levers" or which == "swing" else "tip")


def test_legend_of_a_machine_with_a_curl() -> None:
    """The stick to the left closes the curl, the positive direction; the labels say so."""
    curled = replace(MODES["levers"], full={"curl": {"bucket_command": 4.0}})
    labels = legend(PATTERNS["ISO"], WORDS, curled)
    assert functions(StickAxes(right_x=-1.0), PATTERNS["ISO"])["curl"] > 0
    assert (labels["right_left"], labels["right_right"]) == ("curl closed", "curl open")


def test_commands() -> None:
    """Positive functions are positive commands, whatever the component is called.

    With a controller the levers are its levers, and what engages it is left to rest. Of the tip, stick in is
    radially inwards, boom up is upwards, left is positive; the controller is on.
    """
    found = commands({"swing": 1, "boom": 0.5, "stick": -1}, MODES["levers"], LEVERS)
    assert found == dict(zip(LEVERS, (4, 3, -6), strict=True))
    found = commands({"boom": 1}, MODES["levers"], CONTROLLER)
    assert found["controller.boom_lever"] == 6
    assert set(found) == set(CONTROLLER[:3])
    found = commands({"swing": 1, "boom": 0.7, "stick": 0.7}, MODES["tip"], CONTROLLER)
    assert found == dict(zip(CONTROLLER[3:], (1, -0.7, 0.7, 0.4), strict=True))


def test_modes() -> None:
    """A machine without a controller has no tip mode, one without levers none at all."""
    assert modes(MODES, LEVERS) == ("levers",)
    assert modes(MODES, CONTROLLER) == ("levers", "tip")
    assert modes(MODES, ("engine.speed",)) == ()


@pytest.mark.parametrize("mode", ["levers", "tip"])
@given(sticks=st.builds(StickAxes, *[DEFLECTIONS] * 4), name=st.sampled_from(sorted(PATTERNS)))
def test_commands_are_bounded(sticks: StickAxes, name: str, mode: str) -> None:
    """No position of the sticks commands more than full."""
    found = commands(functions(sticks, PATTERNS[name]), MODES[mode], CONTROLLER)
    most = {**MODES[mode].constant}
    for driven in MODES[mode].full.values():
        most |= driven
    assert all(abs(value) <= abs(most[axis.partition(".")[2]]) for axis, value in found.items())
