"""From deflections to commands: curve, patterns, modes."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from view.standin import CONTROLLER, DESCRIPTION, LEVERS, MODES

from orchestrator.base.errors import Problem
from orchestrator.drive.sticks import ResponseCurve, StickAxes, commands, functions, legend, modes, response

CURVES = st.builds(ResponseCurve, st.floats(0, 0.9), st.floats(0, 1))
DEFLECTIONS = st.floats(-1, 1)
SMALL, FULL = ResponseCurve(0.1, 0.5), ResponseCurve(0.0, 0.0)
PATTERNS, WORDS = DESCRIPTION.patterns, DESCRIPTION.functions
# the function that a stick to the right, or away from the operator, moves; in its negative direction
SIDES = {
    "ISO": {"left_x": "swing", "left_y": "stick", "right_x": "curl", "right_y": "boom"},
    "SAE": {"left_x": "swing", "left_y": "boom", "right_x": "curl", "right_y": "stick"},
}


@given(CURVES, DEFLECTIONS)
def test_curve_is_odd_and_bounded(curve: ResponseCurve, x: float) -> None:
    """Both directions are the same, and no deflection gives more than full speed."""
    assert response(-x, curve) == -response(x, curve)
    assert abs(response(x, curve)) <= 1


@given(CURVES, DEFLECTIONS, DEFLECTIONS)
def test_curve_never_falls(curve: ResponseCurve, a: float, b: float) -> None:
    """A larger deflection never means less."""
    low, high = sorted((a, b))
    # the cubic of numbers a rounding error apart may be a rounding error out of order
    assert response(low, curve) <= response(high, curve) + 1e-15


@given(CURVES)
def test_curve_ends(curve: ResponseCurve) -> None:
    """Nothing in the dead zone, everything at the stop and beyond it."""
    assert response(curve.dead_zone, curve) == 0
    # exact identity up to rounding: (1 - d) / (1 - d), and c + (1 - c)
    assert response(1.0, curve) == pytest.approx(1, rel=1e-14)
    assert response(1e9, curve) == response(1.0, curve)
    assert response(float("nan"), curve) == 0


def test_curve_by_hand() -> None:
    """Half-way beyond the dead zone of 0.1 at half progression is 0.5 * 0.5 + 0.5 * 0.125."""
    # exact identity, rounding only
    assert response(0.55, SMALL) == pytest.approx(0.3125, rel=1e-14)


@pytest.mark.parametrize("wrong", [(-0.1, 0.5), (1.0, 0.5), (0.1, 1.1), (float("nan"), 0.5)])
def test_curve_refuses(wrong: tuple[float, float]) -> None:
    """A curve that would divide by zero or turn round is refused."""
    with pytest.raises(Problem, match="curve: expected"):
        ResponseCurve(*wrong)


@pytest.mark.parametrize("name", PATTERNS)
def test_patterns(name: str) -> None:
    """Each axis moves the one function that ISO 10968 and SAE J1814 give it, in their direction."""
    for axis, which in SIDES[name].items():
        found = functions(StickAxes(**{axis: 1.0}), PATTERNS[name], FULL)
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
        found = functions(StickAxes(**{f"{hand}_{axis}": float(sign)}), PATTERNS[name], FULL)
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
    assert functions(StickAxes(right_x=-1.0), PATTERNS["ISO"], FULL)["curl"] > 0
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
    found = commands(functions(sticks, PATTERNS[name], ResponseCurve()), MODES[mode], CONTROLLER)
    most = {**MODES[mode].constant}
    for driven in MODES[mode].full.values():
        most |= driven
    assert all(abs(value) <= abs(most[axis.partition(".")[2]]) for axis, value in found.items())
