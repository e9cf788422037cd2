"""Shaped moves: impulses that leave no sway, a path that stays the path, a head that hangs still after it."""

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.sway import NAMES, circular, residual, straight
from fmus.controller.paths import PATHS
from fmus.machine.feasible import MECHANICS
from fmus.machine.path_following import points
from fmus.machine.sway import impulses, remaining, shaped, shaper, together
from fmus.package_files import data
from orchestrator import Trace, load
from orchestrator.__main__ import main
from orchestrator.data.trace import read_trace
from orchestrator.ssp.swap import with_swaps

PENDULUM = {"manipulator": "pendulum"}


def left(period: float, damping: float, actual: float) -> float:
    """Sway after the impulses over that after one at their end, of a head with another period."""
    late, weights = impulses(period, damping)
    w, root = 2 * math.pi / actual, math.sqrt(1 - damping**2)
    return abs(sum(weights * np.exp((damping + 1j * root) * w * (late - late[-1]))))


@pytest.mark.parametrize("damping", [0.0, 0.1, 0.4])
def test_impulses_leave_no_sway_and_little_where_the_period_is_wrong(damping):
    """Their sum is 1; the sway is 0 with the period, and its slope over the period, too."""
    assert sum(impulses(2.0, damping)[1]) == pytest.approx(1, abs=1e-15)  # rounding
    assert left(2.0, damping, 2.0) < 1e-15  # rounding
    # of second order: the square of pi/2 0.1 %, less with damping; two impulses leave 1.6e-3
    assert left(2.0, damping, 2.002) < 1.01 * (math.pi / 2 * 1e-3) ** 2


@pytest.mark.parametrize("wrong", [0.8, 0.9, 1.1, 1.2])
def test_a_wrong_period_leaves_what_the_formula_says(wrong):
    """Without damping cos(pi/2 T/T')^2: 2 to 4 % for a tenth, 7 to 15 % for a fifth."""
    assert left(1.0, 0.0, wrong) == pytest.approx(math.cos(math.pi / 2 / wrong) ** 2, abs=1e-12)


def amplitude(times, weights, period, damping):
    """Of a mode after impulses, by its displacement and velocity at their end; of a single one it is 1."""
    w, root = 2 * math.pi / period, math.sqrt(1 - damping**2)
    ago = times.max() - times
    decay, phase = weights * np.exp(-damping * w * ago), w * root * ago
    return math.hypot(decay @ np.sin(phase), decay @ np.cos(phase))


MODES = [
    [(1.905, 0.053)],
    [(1.894, 0.069), (1.638, 0.130)],  # a link and a grapple about crossed pins
    [(2.86, 0.006), (0.70, 0.144)],  # a load on a rope
    [(2.2, 0.0), (1.3, 0.4), (0.45, 0.2)],
]


@pytest.mark.parametrize("modes", MODES, ids=len)
def test_convolved_impulses_leave_nothing_of_any_mode(modes):
    """Of unlike modes each is at rest after the last impulse, and the time is the sum of their periods."""
    times, weights = shaper(together(modes))
    assert weights.sum() == pytest.approx(1, abs=1e-14)  # rounding
    assert times.max() == pytest.approx(sum(t / math.sqrt(1 - z**2) for t, z in modes), rel=1e-14)
    for period, damping in modes:
        assert amplitude(times, weights, period, damping) < 1e-14
        assert remaining(times, weights, (period, damping)) < 1e-14
        wrong = 1.1 * period, damping
        assert remaining(times, weights, wrong) == pytest.approx(amplitude(times, weights, *wrong), abs=1e-14)


def test_modes_that_are_alike_have_one_shaper():
    """Two of 5 % apart leave less than 1 % of each, by the closed form; damping tells modes apart, too."""
    (mean,) = together([(2.0, 0.0), (1.9, 0.0), (0.5, 1.57), (0.9, 0.999)])
    assert mean == pytest.approx((1.95, 0.0))
    for period in (1.9, 2.0):
        expected = math.cos(math.pi / 2 * mean[0] / period) ** 2
        # cos(pi f)^2 of three impulses: f of the mean's half period
        assert remaining(*shaper([mean]), (period, 0.0)) == pytest.approx(expected, abs=1e-12)
    assert together([(1.0, 0.05), (2.0, 0.05), (1.0, 0.3)]) == [(2.0, 0.05), (1.0, 0.3), (1.0, 0.05)]


def test_the_sway_of_a_head_is_that_of_a_physical_pendulum(fmu_dir):
    """2 pi sqrt(J/(m g L)) and its damping, with a payload in another pose, too; no head, no sway."""
    machine = with_swaps(load(fmu_dir / "harvester_control.ssp"), PENDULUM)
    as_it_is = MECHANICS.sway(machine.components["manipulator"])
    assert together(as_it_is) == [
        pytest.approx((2.14, 0.1), abs=0.005)
    ]  # README of the manipulator: digits there
    loaded = {"payload_mass": 500.0, "initial_boom_angle": 0.5, "initial_head_angle": 0.2}
    for start in ({}, {"head_inertia": 0.0}, loaded):
        given = {f"manipulator.{n}": x for n, x in start.items()}
        component = machine.with_start(given).components["manipulator"]
        p = component.real_parameters()
        mass = p["head_mass"] + start.get("payload_mass", 0.0)
        inertia, stiffness = (
            p["head_inertia"] + mass * p["head_length"] ** 2,
            mass * p["gravity"] * p["head_length"],
        )
        damping = p["head_joint_damping"] / (2 * math.sqrt(stiffness * inertia))
        expected = 2 * math.pi * math.sqrt(inertia / stiffness), damping
        assert MECHANICS.sway(component) == [pytest.approx(expected, rel=1e-12)] * 2  # rounding
    assert MECHANICS.sway(load(fmu_dir / "harvester_control.ssp").components["manipulator"]) == []


def test_a_shaped_square_is_the_square_with_its_corners_at_rest():
    """All points are on the sides, all corners are reached, each side lasts one damped period longer."""
    scenario = read_trace(data("scenarios/square.csv"))
    made = shaped(scenario, NAMES.path, NAMES.velocity, [(2.0, 0.1)])
    late = impulses(2.0, 0.1)[0][-1]
    # four sides, each rounded up to 5 ms
    assert 0 <= np.ptp(made.time) - np.ptp(scenario.time) - 4 * late <= 4 * 5e-3
    place, corners = points(made, NAMES.path, ""), np.array(PATHS["square"].points)
    away = np.full(len(place), np.inf)
    for a, b in pairwise(corners):
        along = np.clip((place - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        away = np.minimum(away, np.linalg.norm(place - a - along[:, None] * (b - a), axis=1))
    # a chord of the path's samples in cylinder coordinates: 2.5 mm squared over 8 R
    assert away.max() < 3e-7
    still = np.linalg.norm(np.diff(place, axis=0), axis=1) < 1e-9
    for corner in corners:
        assert np.linalg.norm(place[1:][still] - corner, axis=1).min() < 1e-6  # ten digits in the file
    assert not set(NAMES.velocity) & set(made.signals)


def test_a_move_is_convolved_along_its_path():
    """A table of two places jumps in speed: the shaped one goes on by the sum of three delayed ramps."""
    table = Trace(
        np.array([0.0, 1.0, 3.0, 4.0]),
        {"path_radius": np.full(4, 4.0), "path_height": np.array([0, 0, 1, 1.0]), "path_angle": np.zeros(4)},
    )
    made = shaped(table, NAMES.path, NAMES.velocity, [(1.0, 0.0)])
    assert made.time[-1] == pytest.approx(5.0, abs=1e-9)
    late = ((0.25, 0.0), (0.5, 0.5), (0.25, 1.0))
    ramp = sum(share * np.clip((made.time - 1 - t) / 2, 0, 1) for share, t in late)
    np.testing.assert_allclose(made["path_height"], ramp, atol=1e-12)  # rounding


def test_columns_beside_the_path_keep_their_place_on_it():
    """What a scenario commands during the third move is commanded during it still, later by two periods."""
    scenario = read_trace(data("scenarios/square.csv"))
    third = (scenario.time > 10.0) & (scenario.time < 12.0)
    marked = replace(scenario, signals={**scenario.signals, "mark": third.astype(float)})
    made = shaped(marked, NAMES.path, NAMES.velocity, [(2.0, 0.0)])
    begin = made.time[np.flatnonzero(made["mark"] > 0.5)[0]]
    assert begin == pytest.approx(14.0, abs=0.03)  # moves are rounded up to 5 ms, the jump is one sample long


@pytest.mark.parametrize("kind", ["straight", "circle"])
def test_a_shaped_move_leaves_a_tenth_of_the_sway(machine, monkeypatch, kind):
    """The bar, with the head's own period; a fifth of the sway at most if the period is wrong by a fifth."""
    monkeypatch.setattr("benchmarks.sway.MACHINE", machine)
    moves = {
        "straight": straight((4.0, -0.5, 1.0), (4.2, 1.0, 1.0), 0.6),
        "circle": circular(4.5, 1.0, -0.3, 0.6, 0.7),
    }
    ((period, damping),) = together(
        MECHANICS.sway(with_swaps(load(machine), PENDULUM).components["manipulator"])
    )
    free, error = residual("lumped, pendulum", moves[kind])
    assert free > 0.03  # else there is nothing to judge
    left, shaped_error = residual("lumped, pendulum", moves[kind], [(period, damping)])
    assert left < 0.1 * free
    assert shaped_error < error + 2e-3  # the slower motion is tracked as well, to the play of the valves
    for wrong in (0.8, 1.2):
        assert residual("lumped, pendulum", moves[kind], [(wrong * period, damping)])[0] < 0.2 * free


def test_the_command_shapes_and_keeps_the_path(fmu_dir, tmp_path, capsys):
    """A note with the period and both durations, a file that is a scenario, the tip as near as before."""
    system, line = fmu_dir / "harvester_control.ssp", ["--through=4,0,1", "--through=4,0.8,1"]
    given = ["--no-compare", "--swap=manipulator=pendulum", "--limit=10", f"--out={tmp_path}"]
    assert main(["track", str(system), *line, *given, "--shape-sway"]) == 0
    told = capsys.readouterr().out
    assert "note: route is shaped for a head with a period of 2.14 s, damping ratio 0.10: " in told
    assert "; sway that is left: 0.0 % with 2.14 s\n" in told
    assert main(["track", str(system), "--path", str(tmp_path / "route_shaped.csv"), *given]) == 0
    again = capsys.readouterr().out
    one, other = (re.findall(r"^route_shaped .*?((?: +\S+){4})$", x, re.M) for x in (told, again))
    assert [x.split() for x in one] == [x.split() for x in other] != []


def test_a_period_may_be_given_for_a_machine_without_a_head(fmu_dir, tmp_path, capsys):
    """`--sway-period` alone shapes, also where no head is known."""
    system, line = fmu_dir / "harvester_control.ssp", ["--through=4,0,1", "--through=4,0.4,1"]
    given = ["--no-compare", "--swap=swing=lumped", f"--out={tmp_path}", "--sway-period=1.5"]
    assert main(["track", str(system), *line, *given]) == 0
    assert "with a period of 1.50 s, damping ratio 0.00" in capsys.readouterr().out
