"""Limits and time constants of the diagnosis, with their reasons, and references of a healthy machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmus.contract import Group, Quantity, Scalar, make_group
from fmus.parameters import Number

LITRE = 1 / 6e4  # L/min in m3/s
GROUPS: Mapping[str, Mapping[str, tuple[float, str, str, str]]] = {  # value, unit, description, reason
    "Flows": {
        "lag": (0.03, "s", "Lag of the flows from readings", "three readings"),
        "closing": (
            0.1,
            "s",
            "Time constant with which a valve opens or closes at the latest",
            "a slow pilot head, and a bus",
        ),
        "valve_margin": (
            0.4,
            "V",
            "What a command may be off a healthy valve",
            "the healthy machine at another temperature",
        ),
    },
    "Leaks": {
        "closed_command": (
            0.2,
            "V",
            "Command below which a valve is closed",
            "half of the smallest dead band",
        ),
        "settling": (
            0.25,
            "s",
            "Time after which a closed valve counts",
            "amplifier, pilot head and spool; pressures equalise through bad seals within seconds",
        ),
        "window": (
            0.3,
            "s",
            "Lag of the flows of leaks",
            "the resolution of an encoder is 0.1 L/min of a boom then",
        ),
        "memory": (
            3.0,
            "s",
            "Time at rest over which older readings fade",
            "ten windows, some seconds of work: a tenth of a litre per minute is three deviations",
        ),
        "calm_pressure": (
            1e6,
            "Pa",
            "Pressure below which a chamber may be filled by an anti-cavitation valve",
            "twice the preload of the return line",
        ),
        "leak_limit": (
            0.25 * LITRE,
            "m3/s",
            "Loss at 100 bar above which a leak is told",
            "about the least loss that lets a loaded boom sink by 1 deg in 10 s",
        ),
        "air_memory": (
            60.0,
            "s",
            "Time at rest over which older readings of the air fade",
            "an hour of work",
        ),
        "air_limit": (
            0.06,
            "1",
            "Air beyond that of a healthy machine above which it is told",
            "half of what a machine that is filled wrongly has",
        ),
    },
    "Burst and spool": {
        "outlet": (
            2.0,
            "1",
            "Flow out of a chamber over that of its known valve, at most",
            "a return edge may be twice as large as that of the other direction",
        ),
        "burst_margin": (
            15 * LITRE,
            "m3/s",
            "Loss beyond that of the valve that is none",
            "a chamber loses less but for shocks",
        ),
        "burst_volume": (
            3e-5,
            "m3",
            "Oil lost beyond it at which a hose is burst",
            "an arm that stops hard or takes a load loses half of it, in 30 ms",
        ),
        "rest_margin": (
            5 * LITRE,
            "m3/s",
            "The margin after a while at rest, and of oil that passes a closed valve",
            "a fifth of a burst hose at 10 bar",
        ),
        "slow_margin": (
            1 * LITRE,
            "m3/s",
            "The margin when the arm is at rest, too",
            "ten times the noise of flows",
        ),
        "passed_volume": (
            5e-5,
            "m3",
            "Oil that passes a closed valve at which its spool is stuck",
            "an arm that swings on its oil passes half of it to and fro",
        ),
        "response": (
            0.3,
            "1",
            "Flow over that of the known valve, at least",
            "a valve 20 % smaller, with oil of -10 degC",
        ),
        "response_flow": (5 * LITRE, "m3/s", "Least flow that is asked of a stuck spool", "creep speed"),
        "response_time": (0.08, "s", "Time without it", "with the lags 0.2 s in all"),
        "lost_pressure": (
            15e5,
            "Pa",
            "Pressure below which a chamber that does not fill has a burst hose",
            "the weight of an arm or friction needs more",
        ),
        "standby_pressure": (
            35e5,
            "Pa",
            "Supply pressure up to which a load-sensing pump stands by",
            "24 bar, and a leak",
        ),
        "stopped_pressure": (
            10e5,
            "Pa",
            "Supply pressure below which the engine stands",
            "half of the standby",
        ),
    },
    "Valves": {
        "reversal": (0.8, "V", "Command after a reversal from which a valve follows", "8 % of full command"),
        "valve_window": (0.15, "s", "Time in which the command is one sample", "five lags"),
        "valve_memory": (2.0, "s", "Time of motion over which older readings fade", "some ten strokes"),
        "valve_limit": (
            0.5,
            "V",
            "Change of the mean command of an opening above which it is told",
            "a driver that loses a sixth at 3 V",
        ),
        "hysteresis_limit": (
            0.15,
            "V",
            "Change of half the hysteresis above which it is told",
            "3 % of full command",
        ),
        "delay_limit": (
            0.005,
            "s",
            "Change of the lag of all valves above which it is told",
            "a lag that has doubled",
        ),
    },
    "Sensors": {
        "still_time": (0.12, "s", "Time for which a reading of what moves stands still", "twelve readings"),
        "lowest_pressure": (
            -3e5,
            "Pa",
            "Lowest pressure that is a reading",
            "a chamber is empty at -1 bar; zeros are off by less than 1 bar",
        ),
        "highest_pressure": (
            7e7,
            "Pa",
            "Highest pressure that is a reading",
            "the range of a sensor is 600 bar",
        ),
        "highest_reading": (
            5.9e7,
            "Pa",
            "Pressure at the end of the range of a sensor",
            "the range of a sensor is 600 bar",
        ),
        "largest_jump": (
            1.0,
            "rad",
            "Largest step of an angle, or of a length in m",
            "33 rad/s over the lag",
        ),
        "largest_speed": (9.9, "rad/s", "Largest speed that is a reading", "range of a gyroscope"),
    },
    "Weighing": {
        "weighing_lag": (0.5, "s", "Lag of torques", "a period of an arm on its oil"),
        "weighing_memory": (2.0, "s", "Time over which older torques fade", "a stroke"),
        "weighing_error": (20.0, "kg", "What masses that are off add to a deviation", "4 % of the arm"),
        "balance_memory": (30.0, "s", "Time over which older differences of weights fade", "a load"),
        "weighing_limit": (
            60.0,
            "kg",
            "Difference of two weights above which a sensor is told",
            "10 bar at the boom, 15 bar at the stick",
        ),
    },
    "Lines": {
        "slow_memory": (60.0, "s", "Time over which older readings fade", "a minute of work"),
        "return_limit": (
            3e7,
            "Pa.s/m3",
            "Change of the resistance above which it is told",
            "1 bar at 200 L/min",
        ),
        "pump_limit": (
            4e4,
            "Pa",
            "Loss of supply pressure above which it is told",
            "noise and zeros of sensors are a third",
        ),
        "temperature_limit": (
            273.15 + 75,
            "K",
            "Temperature of the oil above which it is told",
            "the fan is at full speed at 65 degC",
        ),
    },
}
_NUMBERS = {n: row for rows in GROUPS.values() for n, row in rows.items()}
Settings: type[Group] = make_group(
    "Settings",
    {
        n: Quantity(unit, text, abs(value), group=heading)
        for heading, rows in GROUPS.items()
        for n, (value, unit, text, _) in rows.items()
    },
)
NUMBERS = {n: Number(value, unit, "assumed", reason) for n, (value, unit, _, reason) in _NUMBERS.items()}

# of an axis: value if no healthy machine was measured
OF_VALVE = ("gain_up", "dead_band_up", "gain_down", "dead_band_down", "half_hysteresis", "valve_delay")
REFERENCES = dict(zip(OF_VALVE, (1.0, 0.0, 1.0, 0.0, 0.2, 0.02), strict=True)) | {"air": 0.0, "weight": 0.0}
OF_MACHINE = {"return_resistance": 4e7, "pump_pressure": 0.0}


def number(name: str, p: Any) -> Scalar:
    """The reference of a finding, from the parameters."""
    return getattr(p, f"{name}_reference")
