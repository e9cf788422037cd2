"""The machine of coupled FMUs: held, moved the way it is told, and driven to and beyond its limits.

Energy: tests/variants/test_balances.py, test_manipulator.py, test_supply.py.
"""

import numpy as np
import pytest
from kit.equations import machine, piston_areas
from kit.mistakes import table

from fmus.machine.parts import FERIC
from fmus.machine.poses import WORK_SPACE, parameter, pose_grid
from fmus.operator_input.work_cycle import COMMANDS, WORK_CYCLE
from fmus.parameters import values
from orchestrator import Problem, run
from orchestrator.data.trace_writer import RowLayout, TraceFile

BOOM_STICK, MANIPULATOR = (values(FERIC.subsystems[n]).p for n in ("boom_stick", "manipulator"))
SUPPLY = values(FERIC.subsystems["swing"]).u["supply_pressure"]
FULL_VACUUM = -101325.0  # Pa gauge
ENGINE = 113.3e3  # W: 152 hp, section 2 of the paper
PISTONS = ("boom", "stick")


@pytest.fixture(scope="module")
def driven(system):
    """driven(stop, numbers, input=...): the trace of a run with inputs that are constant, or over `time`.

    Commands that are not given are zero.
    """

    def trace(stop, numbers=None, record_step=0.01, time=None, **inputs):
        time = [0.0, stop] if time is None else time
        inputs = dict.fromkeys(COMMANDS, 0.0) | inputs
        columns = {n: np.broadcast_to(np.asarray(v, float), len(time)) for n, v in inputs.items()}
        scenario = {"time": np.array(time), **columns}
        return run(system, scenario, stop=stop, set=numbers or {}, record_step=record_step).trace

    return trace


def at(boom, stick):
    """The parameters of a pose."""
    return {f"manipulator.{parameter(j)}": angle for j, angle in (("boom", boom), ("stick", stick))}


def chambers(y, joint):
    return [y[f"boom_stick.{joint}_{side}_pressure"] for side in ("head", "rod")]


def extremes(y, *joints):
    """The lowest and the highest pressure [Pa] in the chambers of these pistons."""
    found = [c for joint in joints for c in chambers(y, joint)]
    return min(c.min() for c in found), max(c.max() for c in found)


def leaked(drop, joint):
    """Largest speed [m/s] of a piston whose ports leak under pressure differences of `drop` [Pa] in all."""
    return BOOM_STICK["valve_leakage"] * drop / piston_areas(BOOM_STICK, joint)[1]


def test_every_pose_starts_at_rest_with_pressure_to_spare():
    """Over the work space forces balance, and chambers hold the arm between tank and 80 % of the supply."""
    model = machine()
    p = model.p.copy()
    for pose in pose_grid(11):
        for name, angle in at(*pose).items():
            p[model.parameters.index(name)] = angle
        columns = model.outputs(model.start(model.x, model.u, p), model.u, p).full()[:, 0]
        y = dict(zip(model.output_names, columns, strict=True))
        for joint in PISTONS:
            # exact identity of the initial pressures; rounding of 1e5 N
            holding = y[f"manipulator.{joint}_holding_force"]
            assert y[f"boom_stick.{joint}_force"] == pytest.approx(holding, rel=1e-9, abs=1e-4)
            assert 0.0 < min(chambers(y, joint)) < max(chambers(y, joint)) < 0.8 * SUPPLY
        assert abs(y["manipulator.swing_acceleration"]) < 1e-12


@pytest.mark.parametrize("pose", list(pose_grid(3)))
def test_a_held_arm_sinks_as_its_leakage_says(driven, pose):
    """In 5 s with closed valves each piston moves by what leaks into its chambers, no more, no less.

    At constant force: x' = (q_h A_h/C_h - q_r A_r/C_r) / (A_h^2/C_h + A_r^2/C_r), q = G_l (P_s - 2 P).
    The swing has no load, so it stands.
    """
    y = driven(5.0, at(*pose))
    for joint in PISTONS:
        p = {n.removeprefix(f"{joint}_"): v for n, v in BOOM_STICK.items()}
        x, beta = y[f"manipulator.{joint}_position"], p["bulk_modulus"]
        head, rod = piston_areas(BOOM_STICK, joint)
        c_head = p["hose_capacitance"] + (p["dead_volume"] + head * x[0]) / beta
        c_rod = p["hose_capacitance"] + (p["dead_volume"] + rod * (p["stroke"] - x[0])) / beta
        q_head, q_rod = (p["valve_leakage"] * (SUPPLY - 2 * np.mean(c)) for c in chambers(y, joint))
        speed = (q_head * head / c_head - q_rod * rod / c_rod) / (head**2 / c_head + rod**2 / c_rod)
        # the load's change along 0.1 mm, and what still rings: 1 % of the 0.2 mm that full leakage would give
        assert x[-1] - x[0] == pytest.approx(5.0 * speed, rel=0.02, abs=2e-6)
        assert np.abs(x - x[0]).max() < 5.0 * leaked(SUPPLY, joint) < 0.3e-3  # m
    assert np.abs(y["manipulator.swing_angle"]).max() < 1e-9


@table(__file__, "signs", "command, signs")
def test_positive_commands_move_the_stated_way_and_negative_ones_back(driven, command, signs):
    """Signs of every port: positive swings left, raises the boom, extends (and so folds) the stick."""
    for direction in (1, -1):
        y = driven(1.0, **{command: 3.0 * direction})
        for speed, sign in signs.items():
            assert y[f"manipulator.{speed}"][-1] * sign * direction > 0.05


@pytest.mark.parametrize(("joint", "command"), [(j, c) for j in PISTONS for c in (10.0, -10.0)])
def test_full_command_into_an_end_stop(driven, joint, command):
    """At full speed a piston goes at most 2 % of its stroke beyond its end, stays there, and says so."""
    y = driven(6.0, at(0.2, -1.4), record_step=2e-3, **{f"{joint}_command": command})
    length, x = MANIPULATOR[f"{joint}_stroke"], y[f"manipulator.{joint}_position"]
    force = y[f"manipulator.{joint}_stop_force"]
    beyond = x - length if command > 0 else -x
    # the FMU refuses to go on at 5 %
    assert 1e-3 < beyond.max() < 0.02 * length
    assert 0 < beyond[-1] < 5e-3  # m
    assert np.all(force * np.sign(command) <= 0)
    assert abs(force[-1]) > 1e4
    # m/s, over the last second: the joint that is not driven still rings and shakes this one
    assert abs(y[f"manipulator.{joint}_velocity"][-500:]).max() < 0.02
    low, high = extremes(y, joint)
    assert low > FULL_VACUUM
    assert high < 1.5 * SUPPLY


def test_a_supply_below_the_load_lets_the_arm_sink(driven):
    """No check valve holds the load (the paper has none): opened upwards at 5 MPa the boom sinks."""
    y = driven(2.0, supply_pressure=5e6, boom_command=3.0)
    assert y["manipulator.boom_velocity"][-1] < -0.01
    assert y["boom_stick.supply_flow"][-1] < 0  # into the supply
    assert chambers(y, "boom")[0][0] > 5e6  # the load is above the supply
    assert extremes(y, "boom")[0] > FULL_VACUUM


def test_reversing_at_full_speed_stays_bounded(driven):
    """All three commands from +6 to -6 V within 20 ms: no tension, no more than 3.5 times the supply."""
    volts = {command: [0.0, 6.0, 6.0, -6.0, -6.0] for command in COMMANDS}
    y = driven(2.0, record_step=5e-3, time=[0.0, 0.3, 0.8, 0.82, 2.0], **volts)
    pressures = [v for n, v in y.signals.items() if n.endswith(("_pressure", "pressure_a", "pressure_b"))]
    assert min(p.min() for p in pressures) > FULL_VACUUM
    assert max(p.max() for p in pressures) < 3.5 * SUPPLY
    for joint, way in (("swing", -1), ("boom", -1), ("stick", 1)):
        assert way * y[f"manipulator.{joint}_speed"][-1] > 0.1


DAMPINGS = [n for n in MANIPULATOR if n.endswith("_damping") and "stop" not in n]
ODD = {
    "no head": {"manipulator.head_mass": 1e-3},
    "upper case of the hose resistance": {f"boom_stick.{j}_hose_resistance": 3.1e11 for j in PISTONS},
    "soft oil": {"boom_stick.bulk_modulus": 2e8},
    # not 0, which stands for the capacitance that follows from length and bore
    "no hoses": {f"boom_stick.{j}_hose_capacitance": 1e-18 for j in PISTONS},
    "no line resistance": {"swing.line_resistance": 1.0},
    "sharp edges": {f"{c}.valve_transition_reynolds": 0.1 for c in ("swing", "boom_stick")},
    "no friction": {f"manipulator.{n}": 0.0 for n in DAMPINGS},
}
FAST = ("swing_speed", "boom_velocity", "stick_velocity")


@pytest.fixture(scope="module")
def usual(driven):
    """Speeds of the machine as it is after 1.5 s with all commands at 4 V."""
    y = driven(1.5, **dict.fromkeys(COMMANDS, 4.0))
    return [y[f"manipulator.{name}"][-1] for name in FAST]


@pytest.mark.parametrize("numbers", ODD.values(), ids=ODD)
def test_odd_numbers_still_give_a_machine(driven, usual, numbers):
    """At the edges of the plausible the machine moves the way it is told, at about the usual speeds."""
    y = driven(1.5, numbers, **dict.fromkeys(COMMANDS, 4.0))
    assert all(np.all(np.isfinite(v)) for v in y.signals.values())
    # the valves' C_R of 6e12 at 4 V rules the speed, none of these numbers does
    assert [y[f"manipulator.{name}"][-1] for name in FAST] == pytest.approx(usual, rel=0.15)


def test_a_violated_requirement_is_told_rather_than_the_nan_that_it_causes(driven):
    """Full command within the dead band divides by zero: the first value asked for names the reason."""
    with pytest.raises(Problem, match='"valve_full_command exceeds valve_dead_band" is violated at t = 0 s'):
        driven(0.01, {"swing.valve_full_command": 0.1})


@pytest.fixture(scope="module")
def cycle(fmu_dir):
    """The trace of the work cycle, a row every 5 ms."""
    return run(fmu_dir / "harvester.ssp", record_step=5e-3).trace


def test_the_work_cycle_stays_where_engine_and_model_are_valid(cycle):
    """Below the power of the engine; in the work space, off the stops, no cavitation, below supply."""
    flow = cycle["swing.supply_flow"] + cycle["boom_stick.supply_flow"]
    assert 0.5 * ENGINE < SUPPLY * flow.max() < 0.8 * ENGINE  # efficiency of the pumps, other consumers
    assert flow.min() > 0  # never back into the pumps
    for name, (low, high) in WORK_SPACE.items():
        assert low < cycle[f"manipulator.{name}"].min() < cycle[f"manipulator.{name}"].max() < high
    for joint in PISTONS:
        assert not np.any(cycle[f"manipulator.{joint}_stop_force"])
    for void in ("swing.swing", "boom_stick.boom", "boom_stick.stick"):
        assert cycle[f"{void}_void_volume"].max() < 1e-7  # where the FMU would warn
    assert extremes(cycle, *PISTONS)[1] < SUPPLY


def test_the_work_cycle_moves_like_a_harvester(cycle):
    """Speeds of a crane of this class: tip below 4 m/s, swing below 1 rad/s, ramps of 0.3 s and more."""
    y = {n: cycle[f"manipulator.{n}"] for n in ("tip_radius", "swing_speed")}
    along, up = (cycle[f"manipulator.tip_{way}_velocity"] for way in ("radial", "vertical"))
    tip = np.hypot(np.hypot(along, up), y["tip_radius"] * y["swing_speed"])
    assert 3.0 < tip.max() < 4.0
    assert 0.5 < abs(y["swing_speed"]).max() < 1.0
    assert min(min(m.rise, m.fall) for m in WORK_CYCLE) >= 0.3
    assert 30.0 <= cycle.time[-1] <= 60.0
    commands = ["swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"]
    active = sum(np.abs(cycle[name]) > BOOM_STICK["valve_dead_band"] for name in commands)
    assert np.mean(active >= 2) > 0.3  # two or three functions at once for a third of the time


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
def test_the_bytes_of_a_number_in_a_file_are_those_announced(cycle, tmp_path, suffix):
    """All that is on the disk when a file is complete, with the rows until then."""
    stop = 2000  # rows, 10 s
    file = TraceFile(tmp_path / f"t{suffix}")
    file.begin(RowLayout(tuple(cycle.signals), cycle.units))
    file.append(cycle.time[:stop], np.column_stack([values[:stop] for values in cycle.signals.values()]))
    file.close()
    file.finish()
    size = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    # other runs of the machine differ by up to a tenth: a command at rest has few digits
    assert size / (stop * (len(cycle.signals) + 1)) == pytest.approx(file.number_size, rel=0.1)
