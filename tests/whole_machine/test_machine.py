"""The whole machine as one ODE: it holds itself, stands still, conserves energy, moves the way it is told."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus.contract import quantities, symbolic
from fmus.machine.parts import CONNECTIONS, INPUTS, SUBSYSTEMS
from fmus.machine.poses import parameter, pose_grid
from fmus.monolith import SAME_TIME, breakpoints, join, merge_times, simulate
from fmus.parameters import values
from orchestrator.base.errors import Problem

MODEL = join(SUBSYSTEMS, CONNECTIONS, INPUTS)
SUPPLY = values(SUBSYSTEMS["swing"]).u["supply_pressure"]
PRESSURES = tuple(f"boom_stick.{a}_{s}_pressure" for a in ("boom", "stick") for s in ("head", "rod"))


def column(outputs, name):
    return outputs[..., MODEL.output_names.index(name)]


def start_at(boom: float, stick: float):
    """Parameters with this pose, and the states that follow at the start."""
    p = MODEL.p.copy()
    for joint, angle in (("boom", boom), ("stick", stick)):
        p[MODEL.parameters.index(f"manipulator.{parameter(joint)}")] = angle
    return p, MODEL.start(MODEL.x, MODEL.u, p)


def constant(stop, **commands):
    """Time and inputs of a run with constant commands."""
    time = np.linspace(0, stop, 11)
    u = MODEL.u.copy()
    for name, value in commands.items():
        u[MODEL.inputs.index(name)] = value
    return time, np.tile(u, (time.size, 1))


def test_holding_pressures_stay_between_tank_and_80_percent_of_supply(capsys):
    """Over the work space the arm is carried with pressure to spare; prints the map."""
    grid = 11
    rows = {}
    for pose in pose_grid(grid):
        p, x = start_at(*pose)
        y = MODEL.outputs(x, MODEL.u, p).full()[:, 0]
        rows[pose] = [float(column(y, name)) for name in PRESSURES]
    table = np.array(list(rows.values())).max(axis=1).reshape(grid, grid) / SUPPLY * 100
    with capsys.disabled():
        print("\nlargest holding pressure, % of supply (rows: boom up, columns: stick out)")
        print("\n".join(" ".join(f"{v:3.0f}" for v in row) for row in table))
    low, high = np.min(list(rows.values())), np.max(list(rows.values()))
    assert low > 0.0  # tank
    assert high < 0.8 * SUPPLY


def test_start_is_consistent_at_every_pose():
    """At the start nothing accelerates beyond what the leakage of the closed valves does."""
    for pose in pose_grid(7):
        p, x = start_at(*pose)
        y = MODEL.outputs(x, MODEL.u, p).full()[:, 0]
        for joint in ("boom", "stick"):
            force, hold = (
                column(y, f"boom_stick.{joint}_force"),
                column(y, f"manipulator.{joint}_holding_force"),
            )
            # exact identity of the initial pressures; rounding of 1e5 N
            assert force == pytest.approx(hold, rel=1e-9, abs=1e-4)
        assert abs(column(y, "manipulator.swing_acceleration")) < 1e-12


@pytest.mark.parametrize("pose", list(pose_grid(3)))
def test_closed_valves_hold_every_pose_for_5_s(pose):
    """No piston moves farther than its leakage flow times time over its area.

    Each chamber gains or loses at most G_leak P_s t of oil, its pressure being between tank and supply:
    dx < t G_leak P_s / A_rod. The joint follows by 1/J. The swing has no load, so it stands.
    """
    time, u = constant(5.0)
    _, y = simulate(MODEL, time, u, start_at(*pose)[0])
    p = values(SUBSYSTEMS["boom_stick"]).p
    for joint in ("boom", "stick"):
        area = np.pi / 4 * (p[f"{joint}_bore"] ** 2 - p[f"{joint}_rod"] ** 2)
        bound = 5.0 * p["valve_leakage"] * SUPPLY / area
        moved = np.abs(
            column(y, f"manipulator.{joint}_position") - column(y[0], f"manipulator.{joint}_position")
        )
        assert moved.max() < bound
        assert bound < 0.3e-3  # m: the bound itself is small, so that this test means something
    assert np.abs(column(y, "manipulator.swing_angle")).max() < 1e-9


@pytest.mark.parametrize(
    ("command", "speed", "sign"),
    [
        ("swing_command", "manipulator.swing_speed", 1),
        ("boom_command", "manipulator.boom_speed", 1),
        ("boom_command", "manipulator.boom_velocity", 1),
        ("stick_command", "manipulator.stick_velocity", 1),
        ("stick_command", "manipulator.stick_speed", -1),
    ],
)
def test_positive_commands_move_the_stated_way_and_negative_ones_back(command, speed, sign):
    """Signs of every port: positive swings left, raises the boom, extends (and so folds) the stick."""
    for direction in (1, -1):
        time, u = constant(1.0, **{command: 3.0 * direction})
        _, y = simulate(MODEL, time, u)
        assert column(y[-1], speed) * sign * direction > 0.05


def test_a_run_against_the_end_stop_stays_finite_and_says_so():
    """The boom driven up for 6 s ends within 5 mm of its stroke, shows the stop force, below 2 P_s."""
    time = np.linspace(0, 6, 601)
    u = np.tile(MODEL.u, (601, 1))
    u[:, MODEL.inputs.index("boom_command")] = 5.0
    _, y = simulate(MODEL, time, u)
    stroke = values(SUBSYSTEMS["manipulator"]).p["boom_stroke"]
    assert stroke < column(y, "manipulator.boom_position")[-1] < stroke + 5e-3
    assert column(y, "manipulator.boom_stop_force")[-1] < -1e4
    assert max(column(y, name).max() for name in PRESSURES) < 2 * SUPPLY
    assert min(column(y, name).min() for name in PRESSURES) > -1e5


def test_lowering_fast_makes_the_oil_cavitate():
    """A load outruns the pump: a cavity shows, and no pressure falls below absolute vacuum."""
    model = join(SUBSYSTEMS, CONNECTIONS, INPUTS)
    time = np.linspace(0, 1.2, 241)
    u = np.tile(model.u, (241, 1))
    u[:, model.inputs.index("boom_command")] = np.interp(time, [0, 0.1, 0.6, 0.62], [0, 8, 8, 0])
    _, y = simulate(model, time, u)
    assert column(y, "boom_stick.boom_void_volume").max() > 1e-6
    assert min(column(y, name).min() for name in PRESSURES) > -1e5


def test_energy_balance_of_every_subsystem_closes():
    """Power in = power out + stored + heat at random states, with the known defect of moving volumes.

    That defect, (A_h P_h^2 - A_r P_r^2) x' / (2 beta), is explained in docs/equations.md, section 7.
    """
    rng = np.random.default_rng(1)
    for name, sub in SUBSYSTEMS.items():
        s, v = symbolic(sub), values(sub)
        y = dict(zip(quantities(sub.outputs), ca.vertsplit(s.y), strict=True))
        u = dict(zip(quantities(sub.inputs), ca.vertsplit(s.u), strict=True))
        energy = y["stored_energy"] if "stored_energy" in y else y["kinetic_energy"] + y["potential_energy"]
        moving = [n for n in u if n.endswith("_position")]  # positions change with their velocities
        rate = ca.jtimes(energy, s.x, s.dx) + sum(
            ca.jacobian(energy, u[n]) * u[n.replace("position", "velocity")] for n in moving
        )
        balance = ca.Function(
            "b", [s.x, s.u, s.p], [_power(name, u, y, s, sub), rate + y["dissipated_power"]]
        )
        for _ in range(50):
            x, uu = _random(sub, rng)
            power_in, used = (float(b) for b in balance(x, uu, list(v.p.values())))
            # exact identity; 1e-9 is 1e6 rounding errors of terms up to 1e6 W
            assert power_in == pytest.approx(used, rel=1e-9, abs=1e-3), name


def _power(name, u, y, s, sub):
    x = dict(zip(quantities(sub.states), ca.vertsplit(s.x), strict=True))
    if name == "manipulator":
        return (
            y["payload_power"]
            + u["swing_torque"] * x["swing_speed"]
            + (u["boom_force"] + y["boom_stop_force"]) * y["boom_velocity"]
            + (u["stick_force"] + y["stick_stop_force"]) * y["stick_velocity"]
        )
    hydraulic = u["supply_pressure"] * y["supply_flow"] - u["tank_pressure"] * y["return_flow"]
    if name == "swing":
        return hydraulic - y["swing_torque"] * u["swing_speed"]
    p = dict(zip(quantities(sub.parameters), ca.vertsplit(s.p), strict=True))
    power = hydraulic
    for a in ("boom", "stick"):
        head = np.pi / 4 * p[f"{a}_bore"] ** 2
        rod = head - np.pi / 4 * p[f"{a}_rod"] ** 2
        defect = (head * x[f"{a}_head_pressure"] ** 2 - rod * x[f"{a}_rod_pressure"] ** 2) / (
            2 * p["bulk_modulus"]
        )
        power += (defect - y[f"{a}_force"]) * u[f"{a}_velocity"]
    return power


def _random(sub, rng):
    """States and inputs in the working range: 0.5 to 25 MPa, up to 1 L/s, positions in the stroke."""

    def draw(name, nominal, start):
        if "pressure" in name:
            return rng.uniform(5e5, 2.5e7)
        if "position" in name:
            return rng.uniform(0.1, 0.5)
        if name in ("boom_angle", "stick_angle"):
            return start + rng.uniform(-0.3, 0.3)
        return rng.uniform(-1, 1) * nominal

    v = values(sub)
    start = symbolic(sub).initial()(*(list(group.values()) for group in (v.x, v.u, v.p))).full()[:, 0]
    x = [draw(n, q.nominal, x0) for (n, q), x0 in zip(quantities(sub.states).items(), start, strict=True)]
    u = [draw(n, q.nominal, v.u[n]) for n, q in quantities(sub.inputs).items()]
    return x, u


def test_breakpoints_are_the_corners_of_a_piecewise_linear_signal():
    """Only samples where the slope changes, and both ends, split the integration."""
    t = np.linspace(0, 1, 101)
    bent = np.interp(t, [0, 0.2, 0.5, 1.0], [0, 1, 1, 0])[:, None]
    assert list(breakpoints(t, bent)) == [0, 20, 50, 100]
    assert list(breakpoints(t, 2e7 + 1e6 * bent)) == [0, 20, 50, 100]  # Pa: rounding makes no corners
    uneven = np.array([0.0, 0.2, 0.201, 0.5, 1.0])
    line = np.interp(uneven, [0, 0.2, 0.5, 1.0], [0, 1, 1, 0])[:, None]
    assert list(breakpoints(uneven, line)) == [0, 1, 3, 4]


@pytest.mark.parametrize("gap", [1e-9, 1e-6, 1e-5])
def test_breakpoints_give_the_samples_of_a_dense_curve(gap):
    """Where no sample of a curve is a corner for its neighbours, lines between breakpoints still pass it."""
    t = np.unique(np.concatenate([np.linspace(0, 1, 101), np.linspace(0, 1, 101)[:-1] + gap]))
    curve = np.column_stack([np.sin(t), 2e7 + 1e6 * np.cos(t)])
    corners = breakpoints(t, curve)
    for k, allowed in ((0, 1e-9), (1, 8 * np.finfo(float).eps * 2.1e7)):  # tolerance; rounding of pressures
        assert np.max(np.abs(np.interp(t, t[corners], curve[corners, k]) - curve[:, k])) <= allowed


def test_grids_that_differ_by_rounding_are_merged():
    """Times that two grids share but for rounding stand once, as the first grid has them; others are kept."""
    first, second = np.linspace(0, 1, 11), np.append(np.cumsum(np.full(10, 0.1)), 1.05)
    assert np.any(np.isin(second, first, invert=True)[:-1])  # rounding makes them differ
    np.testing.assert_array_equal(merge_times(first, second), [*first, 1.05])
    np.testing.assert_array_equal(merge_times(second, first), [0.0, *second])


def test_times_that_are_equal_but_for_rounding_are_refused():
    """No silent line between inputs at equal times: one sentence with the time and the remedy."""
    for bad in ([0.0, 1.0, 1.0 + SAME_TIME / 2, 2.0], [0.0, 1.0, 0.5], [0.0, np.nan, 1.0]):
        with pytest.raises(Problem, match=r"more than 1e-10 s.*merge_times"):
            simulate(MODEL, np.array(bad), np.tile(MODEL.u, (len(bad), 1)))
        with pytest.raises(Problem, match="more than 1e-10 s"):
            merge_times(np.array([0.0, 2.0]), np.array(bad))


def test_monolith_reaches_its_tolerance():
    """Halving the tolerance exponent changes the result by what the looser tolerance allows."""
    time = np.linspace(0, 2, 201)
    u = np.tile(MODEL.u, (201, 1))
    u[:, MODEL.inputs.index("boom_command")] = np.interp(time, [0, 0.3, 1.0, 1.4], [0, 4, 4, 0])
    loose, tight = simulate(MODEL, time, u, tolerance=1e-8)[0], simulate(MODEL, time, u, tolerance=1e-11)[0]
    # integrator error: 1e-8 per step, some hundred steps
    assert np.max(np.abs(loose - tight) / MODEL.nominal) < 1e-5
