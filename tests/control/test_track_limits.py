"""What a path asks of the machine is told before it runs: reach, strokes, speeds, flow, pressure."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from kit.equations import Part
from kit.mistakes import refused
from kit.steering import arm_angles

from benchmarks.sway import NAMES, circular, straight
from fmus.controller import CONTROLLER
from fmus.controller.paths import PATHS, controller_inputs, sample, start_angles
from fmus.machine.feasible import MECHANICS, _follow, _loads, exceeded
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values
from orchestrator import Trace, load, run
from orchestrator.__main__ import main
from orchestrator.ssp.swap import with_swaps

PARTS = NAMES.follower, NAMES.controller
UP = straight((4.0, 0.0, 0.2), (4.0, 0.0, 1.8), 0.5)
ALONE = ["--no-compare", "--swap=swing=lumped"]
PUMPS = {"swing": "detailed", "boom_stick": "detailed", "supply": "engine_pump"}


def placed(machine, move, swaps=(), **given):
    """The system with the tip on the first point of a move."""
    first = tuple(float(move[n][0]) for n in NAMES.path)
    start = {n.replace("__", "."): x for n, x in given.items()}
    return with_swaps(load(machine), dict(swaps)).with_start(start_angles("", first, {}) | start)


def told(machine, move, swaps=(), **given) -> list[str]:
    path = np.array([move[n] for n in NAMES.path])
    return list(exceeded(placed(machine, move, swaps, **given), MECHANICS, PARTS, move.time, path))


def test_joints_and_loads_along_a_path_are_those_of_the_machine(machine):
    """On a diagonal: angles of the law of cosines, holding forces of the manipulator there."""
    move = straight((3.7, -0.5, 0.4), (5.0, 0.6, 1.6), 0.5)
    path, part = np.array([move[n] for n in NAMES.path])[:, ::20], placed(machine, move).components
    p = MECHANICS.parameters(part["controller"])
    joints, away = _follow(MECHANICS.arm, p, path, part["manipulator"].real_parameters())
    assert away.max() < 1e-6  # three steps of Newton's method from 50 mm away
    loads, arm = _loads(MECHANICS, part["manipulator"], joints), Part(MANIPULATOR)
    for k in range(0, path.shape[1], 7):
        boom, stick = arm_angles(path[0, k], path[1, k])
        assert joints[:, k] == pytest.approx([path[2, k], boom, stick], abs=1e-6)
        y = arm(np.array([path[2, k], boom, stick, 0, 0, 0, 0, 0]))[1]
        held = [0.0, y["boom_holding_force"], y["stick_holding_force"]]
        assert loads[:, k] == pytest.approx(held, rel=1e-5, abs=1e-3)  # the slope over that micrometre


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("swaps", [{}, PUMPS], ids=["ideal", "pumps"])
def test_the_paths_of_the_command_ask_nothing_special(machine, name, swaps):
    """Line and square are within all limits, of both machines."""
    time, place, velocities = sample(PATHS[name])
    columns = controller_inputs(place, velocities).T[3:6]
    assert told(machine, Trace(time, dict(zip(NAMES.path, columns, strict=True))), swaps) == []


def test_a_swing_that_is_too_fast_is_told_with_the_time_that_it_needs(machine):
    """Around at about 0.8 rad/s with 0.6 allowed: the joint, both speeds, and that much more time."""
    move = circular(4.5, 1.0, -1.0, 2.0, 0.9)
    move = replace(move, time=move.time / 4)
    (line,) = told(machine, move)
    speed = np.gradient(move["path_angle"], move.time)
    moving = np.ptp(move.time[speed > 0.02 * 0.6])
    needs, asked = map(float, re.search(r"needs ([\d.]+) s, asked ([\d.]+) s", line).groups())
    assert f"swing needs {speed.max():.3g} rad/s, the controller allows 0.6 rad/s" in line
    assert asked == pytest.approx(moving, abs=0.06)  # a digit, and a sample of 10 ms
    assert needs == pytest.approx(moving * speed.max() / 0.6, abs=0.1)


def test_a_valve_that_is_too_small_is_told(machine):
    """With a valve of a quarter of the area that just does, four times as long; with more area nothing."""
    area = 4e-5 / 20
    (line,) = told(machine, UP, controller__valve_area=area)
    needs, gives = map(float, re.search(r"boom needs (\S+) m/s, its valve gives (\S+) m/s", line).groups())
    just = area * needs / gives
    # three digits, and the drop of the hoses, which grows with the valve
    assert told(machine, UP, controller__valve_area=1.03 * just) == []
    assert len(told(machine, UP, controller__valve_area=0.98 * just)) == 1


def test_a_pump_that_is_too_small_is_told(machine):
    """Two pumps of 1 cm3/rad at 2500 rpm give 31 L/min: the functions together need more."""
    (line,) = told(machine, UP, PUMPS, supply__pump_displacement=1e-6)
    assert f"L/min, the pump gives {2 * 1e-6 * 261.7994 * 6e4:.0f} L/min; the motion needs" in line
    enough = float(re.search(r"need (\d+) L/min", line)[1]) / 6e4 / 2 / 261.7994
    assert told(machine, UP, PUMPS, supply__pump_displacement=1.02 * enough) == []  # two digits


@pytest.mark.parametrize("payload", [0.0, 764.0])
def test_the_pressure_is_that_of_the_load_and_a_margin(machine, payload):
    """Upwards from a supply of 60 bar: the holding force of a run over the area, and 5 bar for the valve."""
    first = tuple(float(UP[n][0]) for n in NAMES.path)
    given = {"manipulator.payload_mass": payload} | start_angles("", first, {})
    names = ["controller.pressure_use", "supply.supply_pressure", "manipulator.boom_holding_force"]
    trace = run(machine, UP, record=names, record_step=0.05, set=given).trace
    use, supply, force = (trace[n] for n in names)
    (line,) = told(machine, UP, manipulator__payload_mass=payload, supply__pressure_setting=60e5)
    need = float(re.search(r"boom needs (\d+) bar .* the supply gives 60 bar", line)[1])
    area = math.pi / 4 * values(CONTROLLER).p["boom_bore"] ** 2
    moved = force / area / 1e5 + 5
    assert need == pytest.approx(moved.max(), abs=0.8)  # no digit behind the point; slow at the very end
    middle = (trace.time > 2) & (trace.time < 4)  # the load of `pressure_use` is filtered over 0.4 s: 6 %
    np.testing.assert_allclose((use * supply / 1e5)[middle], moved[middle], rtol=0.06)


def test_a_path_beyond_a_stroke_is_a_warning_and_runs(machine, tmp_path, capsys):
    """The piston, where it would be, and its range, above the table; the run then tells its cause."""
    line = ["--through=3,0,0", "--through=6.1,0,0", *ALONE, f"--out={tmp_path}"]
    assert main(["track", str(machine), *line]) == 0
    out = capsys.readouterr().out
    place = "route, swing=lumped: at 8.1 s (radius 6.10 m, height 0.00 m)"
    told = f"warning: {place}: the piston of stick is at -0.035 m, expected 0.015 to 0.710 m"
    assert told in out
    assert out.index(told) < out.index("largest [mm]")
    assert "the path leads beyond the end of a stroke, from" in out
    (run_,) = json.loads((tmp_path / "tracking.json").read_text())["runs"]
    assert run_["largest uses of limits"]["controller.stroke_use"] > 1


def test_a_path_that_leaves_the_reach_midway_is_refused(machine, tmp_path, capsys):
    """A table with reachable ends and an unreachable middle: one line with machine, path, time and place."""
    table = tmp_path / "far.csv"
    rows = "".join(f"{t},{4 + 2.5 * math.sin(math.pi * t / 8):.6f},1,0\n" for t in range(9))
    table.write_text("time,path_radius,path_height,path_angle\n" + rows)
    line = refused(capsys, ["track", machine, "--path", table, "--out", tmp_path])
    place = r"path far: at [23]\.\d s \(radius 6\.\d\d m, height 1\.00 m\)"
    assert re.search(rf"machine lumped, {place}: out of reach", line)


def test_a_jump_of_the_path_is_too_fast_and_not_out_of_reach(machine):
    """1.8 m in a hundredth of a second: a warning of the speed, and the elbow stays above."""
    jump = {"path_radius": np.where(UP.time < 2, 4.0, 5.8), "path_height": np.full(UP.time.size, 0.5)}
    (line,) = told(machine, replace(UP, signals={**UP.signals, **jump}))
    assert re.search(r"at 2\.\d s .* needs .* the controller allows ", line)


def test_a_path_that_is_not_followed_is_not_judged(machine, tmp_path, capsys):
    """With `follow` at 0 for a while the tip goes elsewhere: nothing is said of the path."""
    table = tmp_path / "levers.csv"
    table.write_text("time,path_radius,path_height,path_angle,follow\n0,4,1,0,0\n2,9,1,0,0\n3,4,1,0,0\n")
    main(["track", str(machine), f"--path={table}", *ALONE, f"--out={tmp_path}"])
    assert "out of reach" not in capsys.readouterr().out
