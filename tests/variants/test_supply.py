"""The supply: an ideal source, and two pumps on an engine that obey their closed forms and their limits.

Engine, swash plates, valves and rail are those of the load-sensing pump: test_circuits_transcription.py.
"""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.mistakes import table
from kit.properties import examples
from kit.supply_bench import L_MIN, Bench, Load
from scipy.optimize import brentq

from fmus.components import engine_and_pump
from fmus.contract import nested

ENGINE_PUMP, _ = BENCHES = [Bench(name) for name in ("engine_pump", "load_sensing")]
IDEAL = Bench("ideal")
pumps = pytest.mark.parametrize("bench", BENCHES, ids=lambda b: b.sub.variant)
P = ENGINE_PUMP.p
SETTING = P["pump_1_pressure_setting"]
FULL = P["pump_displacement"] * P["engine_rated_speed"]  # m3/s of one pump


def orifice(flow: float, pressure: float = 2e7) -> Load:
    """That takes a flow [m3/s] at a pressure."""
    return Load(flow / np.sqrt(pressure))


def net(speed: float) -> float:
    """The engine's torque curve: rated torque at rated speed, a quarter more at its peak."""
    y = (speed - P["engine_peak_speed"]) / (P["engine_rated_speed"] - P["engine_peak_speed"])
    return P["engine_rated_torque"] * (1 + P["engine_torque_rise"] * (1 - y**2))


def load(speed: float, stroke: float, pressure: float) -> float:
    """Torque of both pumps at one stroke and outlet pressure."""
    hydraulic = (stroke + P["pump_pressure_friction"]) * P["pump_displacement"] * pressure
    return 2 * (hydraulic + P["pump_viscous_friction"] * speed)


FLOWS = st.lists(st.floats(-1e-2, 1e-2), min_size=4, max_size=4)
LOADS = st.lists(st.floats(-1e5, 3e7), min_size=2, max_size=2)


def inputs_of(bench: Bench, flows, loads=(0.0, 0.0)) -> list[float]:
    """Four flows and two load pressures, in the order of the inputs."""
    names = [f"{line}_flow_{d}" for d in ("swing", "boom_stick") for line in ("supply", "return")]
    pressures = dict(zip(("swing_load_pressure", "boom_stick_load_pressure"), loads, strict=True))
    return bench.row(**dict(zip(names, flows, strict=True)), **pressures)


@given(FLOWS)
def test_ideal_source_holds_its_pressure_for_any_flow(flows):
    """Setting and tank pressure, rate zero, and the power that these flows carry."""
    row = inputs_of(IDEAL, flows)
    y = IDEAL.show([], row, IDEAL.constants(reservoir_pressure=1e5))
    u = dict(zip(IDEAL.inputs, row, strict=True))
    drives = ("swing", "boom_stick")
    taken, given_back = (sum(u[f"{line}_flow_{d}"] for d in drives) for line in ("supply", "return"))
    assert (y["supply_pressure"], y["supply_pressure_rate"], y["tank_pressure"]) == (SETTING, 0.0, 1e5)
    # exact identity; rounding of 2e5 W
    assert y["hydraulic_power"] == pytest.approx(SETTING * taken - 1e5 * given_back, rel=1e-12, abs=1e-9)
    assert y["engine_power"] == y["hydraulic_power"]


@pytest.mark.parametrize("flow", [10, 50, 150, 250])
def test_pressure_falls_along_the_compensator_line(flow):
    """P = setting - band s - drop over the check valve, with the stroke s that covers flow and leakage."""
    y = ENGINE_PUMP.settled(orifice(flow * L_MIN))
    each = y["supply_flow"] / 2
    s = (each + P["pump_leakage"] * y["pump_1_pressure"]) / (P["pump_displacement"] * y["engine_speed"])
    outlet = SETTING - P["compensator_band"] * (s - P["compensator_rounding"] ** 2 / (4 * s))
    # integrator and what is left of the transient: 1e-6 of 20 MPa
    assert y["pump_1_pressure"] == pytest.approx(outlet, rel=1e-6)
    drop = each * P["check_resistance"] + P["check_opening"] / 2  # straight line above its foot
    if drop > P["check_opening"]:
        assert y["supply_pressure"] == pytest.approx(outlet - drop, rel=1e-6)
    assert y["pump_1_flow"] == pytest.approx(y["pump_2_flow"], rel=1e-9)


def test_engine_lugs_down_to_where_its_curve_meets_the_pumps():
    """Full stroke near the setting needs more than rated torque: speed and pressure by two curves."""
    opened = orifice(2 * FULL, 19e6)
    y = ENGINE_PUMP.settled(opened)

    def lines(speed):
        """Outlet pressure at which full pumps feed the orifice at this speed."""

        def short(p):
            each = P["pump_displacement"] * speed - P["pump_leakage"] * p
            rail = p - each * P["check_resistance"] - P["check_opening"] / 2
            return 2 * each - opened.gain * np.sqrt(rail)

        return brentq(short, 5e6, 25e6)

    speed = brentq(lambda w: net(w) - load(w, 1.0, lines(w)), 180.0, P["engine_rated_speed"])
    assert speed < 0.99 * P["engine_rated_speed"]
    assert y["pump_1_stroke"] > 1 - 1e-3
    # the bench's orifice is laminar below 0.1 MPa, 1e-5 at 18 MPa; the top of the stroke is rounded
    assert y["engine_speed"] == pytest.approx(speed, rel=1e-3)
    assert y["pump_1_pressure"] == pytest.approx(lines(speed), rel=1e-3)
    # the same numbers in closed form: rounding and the integrator
    of_both = load(y["engine_speed"], y["pump_1_stroke"], y["pump_1_pressure"])
    assert y["engine_load"] == pytest.approx(of_both, rel=1e-6)


@pumps
def test_the_return_line_has_its_preload_and_the_drop_to_the_tank(bench):
    """P_b = P_t + p_b + R_b Q + w/2 above the foot of the check valve, p_b without flow."""
    p = bench.constants(reservoir_pressure=2e4)
    assert bench.rest(p)[bench.at("tank_pressure")] == pytest.approx(2e4 + 4e5, rel=1e-12)
    y = bench.settled(Load(100 * L_MIN / 1e3, 5e6), reservoir_pressure=2e4)
    expected = 2e4 + 4e5 + 4e7 * y["return_flow"] + 5e4 / 2
    assert y["return_flow"] > 5e4 / 4e7  # above the foot
    assert y["tank_pressure"] == pytest.approx(expected, rel=1e-5)  # what is left of the transient


@pumps
@pytest.mark.parametrize(("resistance", "flow"), [(1e9, 1e-3), (2.4e8, 4e-3), (4e7, 1.2e-2)])
def test_the_bypass_valve_limits_the_drop_of_the_filter(bench, resistance, flow):
    """Resistance and bypass valve in parallel, by hand; without it 10, 9.6 and 4.8 bar."""
    slope, half = 1 / resistance, bench.p["return_bypass_rounding"] / 2
    half_of_check = 25e3  # Pa, of its rounding
    drop = (flow + slope * half_of_check + 5e-8 * (3e5 + half)) / (slope + 5e-8)
    assert 3e5 + 2 * half < drop < 5e5
    x = bench.rest(bench.constants())
    x[bench.at("tank_pressure")] += drop
    found = bench.rates(x, bench.row(return_flow_swing=flow), bench.constants(return_resistance=resistance))
    # rounding of a difference of flows
    assert found["tank_pressure"] * bench.p["return_capacitance"] == pytest.approx(0, abs=1e-13)


@pumps
def test_the_oil_settles_where_cooler_and_tank_give_off_the_heat(bench):
    """T = T_a + (engine power - engine friction) / (G + G_c), cooler at full speed, and without a cooler."""
    for own in ({"cooler_setting": 250.0}, {"cooler_conductance": 0.0, "tank_conductance": 1050.0}):
        y = bench.settled(Load(20 * L_MIN / 1e3, 5e6), heat_capacity=140.0, **own)
        heat = y["engine_power"] - (40.0 + 0.17 * y["engine_speed"]) * y["engine_speed"]
        # 30 time constants; the dry friction of the engine is rounded by 7e-6
        assert y["oil_temperature"] == pytest.approx(293.15 + heat / 1050.0, rel=1e-6)
        assert y["cooling_power"] == pytest.approx(heat, rel=1e-4)


@pumps
def test_heat_by_cause_is_that_of_each_part(bench):
    """By torques, flows and pressures of engine, pumps, valves and return line; they sum to the heat."""
    y = bench.settled(Load(20 * L_MIN / 1e3, 1.4e7), relief_pressure=1.5e7)  # open in both variants
    w, names = y["engine_speed"], [n.removesuffix("_stroke") for n in y if n.endswith("_stroke")]
    size = bench.p.get("pump_displacement", bench.p.get("main_pump_displacement"))
    suction = {n: y[f"{n}_stroke"] * size * w for n in names}
    outlet, rail = {n: y[f"{n}_pressure"] for n in names}, y["supply_pressure"]
    expected = {
        "engine_friction_heat": (40.0 + 0.17 * w) * w,
        "pump_friction_heat": y["engine_load"] * w - sum(suction[n] * outlet[n] for n in names),
        "leakage_heat": sum((suction[n] - y[f"{n}_flow"]) * outlet[n] for n in names)
        + y.get("rail_leakage_flow", 0.0) * rail,
        "check_valve_heat": sum(y[f"{n}_flow"] * (outlet[n] - rail) for n in names),
        "relief_heat": y["relief_flow"] * rail,
        "return_line_heat": y["return_flow"] * y["tank_pressure"],
    }
    # what is left of the transient; the dry friction of the engine is rounded by 7e-6
    assert {n: v for n, v in y.items() if n.endswith("_heat")} == pytest.approx(expected, rel=1e-4)
    assert sum(y[n] for n in expected) == pytest.approx(y["dissipated_power"], rel=1e-9)
    assert min(y[n] for n in expected) > 0


def stroke_after(start: float, pressure: float, time: float) -> float:
    """Stroke of the first pump at a constant outlet pressure."""
    s, pump = ca.SX.sym("s"), nested(ENGINE_PUMP.sub.parameters, P).pumps["pump_1"]
    ode = {"x": s, "ode": engine_and_pump.stroke_rate(pump, s, pressure)}
    options = {"reltol": 1e-10, "abstol": 1e-12}
    return float(ca.integrator("s", "cvodes", ode, 0.0, time, options)(x0=start)["xf"])


def test_steps_take_the_stroke_times_and_the_lag_of_the_data_sheet():
    """Far off, 9/10 of the stroke take 9/10 of the shortest time; a small step 63 % within a lag."""
    # the limit is approached as (r_max / r)^2 / 2: below 3 % while a tenth of the stroke is missing
    assert stroke_after(0.0, 0.0, 0.9 * P["pump_stroke_time"]) == pytest.approx(0.9, abs=0.02)
    assert stroke_after(1.0, 2 * SETTING, 0.9 * P["pump_destroke_time"]) == pytest.approx(0.1, abs=0.06)
    assert P["pump_destroke_time"] < P["pump_stroke_time"]
    line = SETTING - 0.5 * P["compensator_band"]
    begin = stroke_after(0.5, line, 1.0)
    after = stroke_after(begin, line - 0.01 * P["compensator_band"], P["compensator_lag"])
    # the rate limit takes off (r / r_max)^2 / 2 = 2 % at first
    assert after - begin == pytest.approx(0.01 * (1 - np.exp(-1)), rel=0.02)


@examples(10)
@given(st.lists(st.integers(0, 900), min_size=3, max_size=6), st.floats(0.1, 0.6))
def test_limits_hold_for_any_row_of_loads(flows, hold):
    """Pressures stay below and above their bounds, no stall, no run-away."""
    _, y = ENGINE_PUMP.through([orifice(q * L_MIN) for q in flows], ENGINE_PUMP.constants(), hold, 20)
    for i in (1, 2):
        assert y[f"pump_{i}_pressure"].max() < 1.3 * P["relief_pressure"]
    assert y["engine_speed"].min() > 0.6 * P["engine_rated_speed"]
    assert y["engine_speed"].max() < 1.05 * P["engine_no_load_speed"]
    assert y["supply_pressure"].min() > -1e5


# of the engine, the tank and the oil
SHAFT = {"engine_speed": st.floats(0.0, 300.0), "engine_fuel_torque": st.floats(0.0, 600.0)}
SHAFT |= {"reservoir_volume": st.floats(0.0, 0.3), "tank_pressure": st.floats(-1e5, 3e6)}
SHAFT |= {"oil_temperature": st.floats(253.0, 373.0)}
STATE = (
    st.lists(st.floats(-1e5, 3e7), min_size=3, max_size=3),
    st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2),
    st.fixed_dictionaries(SHAFT),
)
PUMPS = {"engine_pump": ("pump_1", "pump_2"), "load_sensing": ("pump",)}


@pumps
@given(*STATE)
def test_pumps_never_take_oil_back(bench, pressures, strokes, shaft):
    """Whatever the pressures, the check valves let oil out only, and none at all against the pressure."""
    y = bench.show(bench.state(pressures, strokes, **shaft), bench.row(), bench.constants())
    for pump in PUMPS[bench.sub.variant]:
        assert y[f"{pump}_flow"] >= 0
        if y[f"{pump}_pressure"] <= y["supply_pressure"]:
            assert y[f"{pump}_flow"] == 0


@pumps
@given(STATE[0], STATE[2], st.sampled_from([0.0, 1.0]))
def test_strokes_turn_back_at_their_ends(bench, pressures, shaft, end):
    """At no stroke the rate is not negative, on full stroke not positive: 0 ... 1 is never left."""
    x = bench.state(pressures, [end, end], **shaft)
    dx = bench.rates(x, bench.row(), bench.constants())
    for pump in PUMPS[bench.sub.variant]:
        assert dx[f"{pump}_stroke"] * (1 - 2 * end) >= -1e-12  # rounding of 1


@pumps
@given(st.lists(st.floats(-1e12, 1e12), min_size=10, max_size=10), FLOWS)
def test_any_trial_state_gives_finite_rates(bench, x, flows):
    """A solver may try anything: neither infinity nor not-a-number comes back, nor from the derivatives."""
    found = bench.jacobian(x[: len(bench.states)], inputs_of(bench, flows), bench.constants())
    assert all(np.isfinite(part.full()).all() for part in found)


@pumps
@given(*STATE, FLOWS, LOADS, st.sampled_from([0.0, 2e5]))
def test_energy_balance_closes_at_any_state(bench, pressures, strokes, shaft, flows, loads, tank):
    """Combustion and return lines give what drives, stored energy and heat take; heat is never negative."""
    x, u = bench.state(pressures, strokes, **shaft), inputs_of(bench, flows, loads)
    into, used, heat = map(float, bench.balance(x, u, bench.constants(reservoir_pressure=tank)))
    # exact identity; rounding of terms up to 1e7 W (a void at 3e-10 s)
    assert into == pytest.approx(used, rel=1e-9, abs=1e-3)
    assert heat >= -1e-9


@pumps
@given(st.lists(st.floats(0.0, 3e7), min_size=3, max_size=3), *STATE[1:], st.floats(0.01, 0.2))
def test_pumps_draw_no_more_oil_than_there_is(bench, pressures, strokes, shaft, suction):
    """All of their flow down to suction_volume, then the s-curve, none from half of it on: V > 0."""
    p, shaft = bench.constants(suction_volume=suction), shaft | {"tank_pressure": 5e5}

    def gained(volume: float) -> float:
        x = bench.state(pressures, strokes, **shaft | {"reservoir_volume": volume})
        return bench.rates(x, bench.row(), p)["reservoir_volume"]

    assert gained(suction / 2) >= 0  # what leaks and comes back
    drawn = gained(suction / 2) - gained(suction)
    for share, s in ((5.0, 1.0), (0.75, 0.5), (0.6, 0.05792), (0.3, 0.0), (-1.0, 0.0)):
        # s = z^3 (10 - 15 z + 6 z^2) by hand, exact; rounding of a difference of flows
        assert gained(suction / 2) - gained(share * suction) == pytest.approx(s * drawn, rel=1e-9, abs=1e-15)


@given(
    st.floats(5e6, 2.1e7),
    st.floats(-2e6, 2e6),
    st.floats(1e5, 5e6),
    st.floats(4e-13, 2e-11),
    st.sampled_from([0.0, 2e5]),
)
def test_rest_stays_at_rest(setting, apart, band, leakage, tank):
    """Whatever the settings, the state at the start does not move while nothing is taken."""
    p = ENGINE_PUMP.constants(
        pump_1_pressure_setting=setting,
        pump_2_pressure_setting=setting + apart,
        compensator_band=band,
        pump_leakage=leakage,
        reservoir_pressure=tank,
    )
    x = ENGINE_PUMP.rest(p)
    dx = ENGINE_PUMP.rates(x, ENGINE_PUMP.row(), p)
    # rounding: 1e-16 of a pressure, over the band, over the lag; through the lines for the pressures
    assert max(abs(dx["pump_1_stroke"]), abs(dx["pump_2_stroke"])) < 1e-9
    assert max(abs(dx[f"{n}_pressure"]) for n in ("supply", "pump_1", "pump_2")) < 1.0  # Pa/s
    assert abs(dx["engine_speed"]) < 1e-9
    assert abs(dx["engine_fuel_torque"]) < 1e-6
    # the stroke that covers the leakage is 0.1 to 20 %, and its foot is rounded
    highest = max(setting, setting + apart)
    assert x[ENGINE_PUMP.at("supply_pressure")] == pytest.approx(highest, abs=0.25 * band)


@table(__file__, "engines", "name, value, fails")
def test_an_engine_too_weak_for_its_pumps_is_told_in_words(name, value, fails):
    """The start is finite for any engine; one that does not turn the pumps says so."""
    p = ENGINE_PUMP.constants(**{name: value})
    assert np.isfinite(ENGINE_PUMP.rest(p)).all()
    assert ENGINE_PUMP.violated(p) == fails
