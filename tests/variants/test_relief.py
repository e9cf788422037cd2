"""What relief and anti-cavitation valves do to the drives; their flow: test_circuits_transcription.py."""

import numpy as np
import pytest
from kit.equations import corners, machine, played
from kit.every import native

from fmus.components import chamber
from fmus.machine.parts import FERIC
from fmus.parameters import values
from orchestrator import Trace, run


def moved(stop, commands, **variants):
    """Outputs of the machine with these commands [V] (times, values) by lever, at 200 Hz."""
    return played(machine(**variants), *corners(stop, commands), tolerance=1e-6)


def test_cross_port_relief_limits_the_braking_of_the_swing():
    """The valve closed at once at speed: `lumped` goes far above the set pressure, `detailed` does not."""
    brake = {"swing_command": ([0.0, 0.1, 1.5, 1.505], [0.0, 9.0, 9.0, 0.0])}
    usual, fine = moved(2.2, brake), moved(2.2, brake, swing="detailed")
    p = values(FERIC.chosen(swing="detailed")["swing"]).p

    def difference(y):
        return np.abs(y["swing.swing_motor_pressure_a"] - y["swing.swing_motor_pressure_b"])

    assert difference(usual).max() > 1.2 * p["relief_pressure"]
    flow = np.abs(fine["swing.swing_relief_flow"])
    over = difference(fine) - p["relief_pressure"]
    assert flow.max() > 1e-5  # m3/s: it opens
    # all that the motor displaces goes through the valve: Q/g above the set pressure; 10 % for the column
    # of oil in the line, which runs on
    displaced = p["motor_displacement"] * p["gear_ratio"] * np.abs(fine["manipulator.swing_speed"]).max()
    most = displaced / p["relief_gain"] + p["relief_rounding"] / 2
    assert 0 < over.max() < 1.1 * most
    assert np.all(flow[over <= 0] == 0.0)


def test_anti_cavitation_valves_leave_a_fifth_of_the_cavity():
    """A boom that outruns the pump and is stopped: chambers of `lumped` tear, those of `detailed` less.

    A seat of 10 mm passes 40 L/min from a return line without pressure, less than the cylinder takes.
    """
    drop = {"boom_command": ([0.0, 0.1, 0.6, 0.62], [0.0, 8.0, 8.0, 0.0])}
    usual, fine = moved(1.2, drop), moved(1.2, drop, boom_stick="detailed")

    def lowest(y):
        return min(y[f"boom_stick.boom_{side}_pressure"].min() for side in ("head", "rod"))

    assert -1e5 < lowest(usual) < 3 * chamber.VAPOUR_PRESSURE  # Pa: above absolute vacuum
    assert usual["boom_stick.boom_void_volume"].max() > 1e-6  # m3
    assert lowest(usual) < lowest(fine) < chamber.VAPOUR_PRESSURE
    assert fine["boom_stick.boom_void_volume"].max() < usual["boom_stick.boom_void_volume"].max() / 5
    assert fine["boom_stick.boom_anti_cavitation_flow"].max() > 1e-5  # m3/s: they work


def test_a_port_below_the_vapour_pressure_is_a_warning(fmu_dir):
    """Motor ports of a driven column, behind a closed valve: a message, and a line of the card."""
    time, part = np.array([0.0, 0.1, 0.11, 0.2]), "swing_lumped"
    turned = Trace(time, {"swing_speed": np.array([0.0, 0.0, 5.0, 5.0])})
    result = run(native(part, fmu_dir), turned, step=1e-3)
    lowest = min((result.trace[f"{part}.swing_motor_pressure_{line}"].min(), line) for line in "ab")
    assert lowest[0] < -101325.0  # below vacuum, while the steps have the status OK
    (told,) = (m.text for m in result.messages if f": swing_motor_pressure_{lowest[1]} = -" in m.text)
    assert told.startswith("the oil column tears off at t = ")
    assert told.endswith(" bar (lower limit -0.2 bar)")
    (line,) = (n for n in result.card.text().splitlines() if f": swing_motor_pressure_{lowest[1]} = " in n)
    assert told in line


@pytest.mark.parametrize("variant", ["lumped", "quasistatic", "detailed"])
def test_a_pressure_beyond_the_class_is_a_warning_where_no_relief_limits_it(fmu_dir, variant):
    """Closed valve, shaft driven: one message for each excursion above 350 bar; `detailed` stays below."""
    part, excursions = f"swing_{variant}", {}
    time = np.array([0.0, 0.1, 0.11, 0.15, 0.17, 0.25, 0.26, 0.4, 0.41, 0.45, 0.47, 0.55, 0.56, 0.7])
    speed = 0.5 * np.array([0, 0, 1, 1, -1, -1, 0, 0, 1, 1, -1, -1, 0, 0])  # rad/s
    done = run(native(part, fmu_dir), Trace(time, {"swing_speed": speed}), step=1e-3)
    for line in ("a", "b"):
        above = done.trace[f"{part}.swing_pressure_{line}"] > 35e6
        messages = [m.text for m in done.messages if f": swing_pressure_{line} = " in m.text]
        excursions[line] = np.count_nonzero(above[1:] & ~above[:-1])
        assert len(messages) == excursions[line]
        assert all(" bar (limit 350 bar): " in text for text in messages)
    assert all(excursions.values()) if variant != "detailed" else not any(excursions.values())
