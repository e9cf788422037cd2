"""Tables of docs/control.md: `python docs/control.py [TABLE ...]`, of those in TABLES.

Largest error and RMS of the tip [mm], but for `stop` and `loop`. Reads build/harvester_control.ssp. Sensors,
sampling and noise are those of tests/kit/sensors.py. A row is a set of start values; more rows are more
entries.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from kit.sensors import Sampled, opener

from fmus.controller.paths import COLUMNS, PATHS, Route, controller_inputs, sample, start, start_angles
from fmus.machine.parts import MACHINES
from orchestrator import Trace, linearize, run

SYSTEM = Path("build/harvester_control.ssp")
TIP = [f"manipulator.tip_{n}" for n in ("x", "y", "height")]
COMPENSATED = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}
KINDS = {**MACHINES, "compensated": COMPENSATED}
THERE_AND_BACK = ((3.6, -2.0, 1.0), (3.6, 2.0, 1.0), (3.6, -2.0, 1.0))
ROUTES = {**PATHS, "fast": Route(THERE_AND_BACK, speed=1.0), "far": Route(((5, -2.5, 1), (5, 2.5, 1)))}
Start = Mapping[str, float]
PAIR = ("line", "square")


def hysteresis(valve: float, assumed: float) -> Start:
    """Hysteresis of the valves, and that which the controller assumes at the start."""
    return {"valve_actuation.hysteresis": valve, "controller.hysteresis": assumed}


def drives(name: str, value: float) -> Start:
    """Of both drives."""
    return {f"{part}.{name}": value for part in ("swing", "boom_stick")}


def oil(celsius: float) -> Start:
    """Oil at this temperature."""
    return {"supply.oil_temperature_start": celsius + 273.15}


NONE, KNOWN = hysteresis(0, 0), hysteresis(0.04, 0.04)
SOFT = {"boom_stick.boom_hose_capacitance": 2.7e-12, "boom_stick.stick_hose_capacitance": 3.6e-12}
OTHERS: Mapping[str, Start] = {
    "as assumed": {},
    "head of 300 kg": {"manipulator.head_mass": 300},
    "head of 600 kg": {"manipulator.head_mass": 600},
    "weaker supply": {"supply.pressure_setting": 15e6},
    "valves 20 % smaller": drives("valve_area", 3.2e-5),
    "20 % larger": drives("valve_area", 4.8e-5),
    "hoses five times as soft": SOFT,
    "dead band 0.5 V, not 0.6 V": drives("valve_dead_band", 0.5),
    "dead band 0.7 V": drives("valve_dead_band", 0.7),
    "oil of -10 °C": oil(-10),
}
PLAYS: Mapping[str, Start] = {
    "none": NONE,
    **{f"{100 * h:g} %, not compensated": hysteresis(h, 0) for h in (0.02, 0.04, 0.08)},
    **{f"{100 * h:g} %, known": hysteresis(h, h) for h in (0.02, 0.04, 0.08)},
    **{f"{100 * h:g} %, 4 % assumed": hysteresis(h, 0.04) for h in (0.0, 0.02, 0.08)},
    **{f"4 %, known, {celsius:g} °C": KNOWN | oil(celsius) for celsius in (-10, 20)},
}
SEEN: Sequence[tuple[str, str, str, Start]] = (
    ("lumped, line", "lumped", "line", {}),
    ("lumped, square", "lumped", "square", {}),
    ("detailed, line", "detailed", "line", {}),
    ("detailed, square", "detailed", "square", {}),
    ("soft hoses, square", "lumped", "square", SOFT),
    ("dead band 0.5 V, square", "lumped", "square", OTHERS["dead band 0.5 V, not 0.6 V"]),
    ("dead band 0.7 V, square", "lumped", "square", OTHERS["dead band 0.7 V"]),
)
STOPS: Mapping[str, tuple[str, Start]] = {
    "lumped": ("lumped", {}),
    "soft hoses": ("lumped", SOFT),
    "dead band 0.7 V": ("lumped", OTHERS["dead band 0.7 V"]),
    "detailed": ("detailed", {}),
    "`piston_damping_rate` 10": ("lumped", {"controller.piston_damping_rate": 10}),
    "the same with soft hoses": ("lumped", SOFT | {"controller.piston_damping_rate": 10}),
}
LOOPS = ((20, 5, 2.0), (20, 10, 2.0), (20, 5, 0.4), (20, 10, 0.4), (5, 10, 2.0), (5, 5, 2.0))


class Slower(Sampled):
    """The controller behind sensors, every 20 ms."""

    period = 20


def error(kind: str, path: str, given: Start, seen: Callable | None = None) -> str:
    """Largest and RMS distance of the tip from the commanded point [mm]; seen: how the controller sees it."""
    _, points, velocities = sample(ROUTES[path])
    columns = dict(zip(COLUMNS, controller_inputs(points, velocities).T, strict=True))
    commanded = Trace(np.arange(len(points)) / 200, columns)
    given = {**start_angles(path, start(ROUTES[path]), {}), **given}
    sampled = {"step": 1e-3, "master": "gauss-seidel", "open": seen} if seen else {}
    trace = run(SYSTEM, commanded, record=TIP, record_step=0.01, swap=KINDS[kind], set=given,
                parameters=["line", *["compensated"] * (kind == "compensated")], **sampled).trace  # fmt: skip
    radius, angle, height = (
        np.interp(trace.time, commanded.time, commanded[f"path_{n}"]) for n in ("radius", "angle", "height")
    )
    wanted = radius * np.cos(angle), radius * np.sin(angle), height
    apart = 1e3 * np.linalg.norm([trace[n] - w for n, w in zip(TIP, wanted, strict=True)], axis=0)
    return f"{apart.max():.1f}, {np.sqrt((apart**2).mean()):.1f}"


def table(head: Sequence[str], rows: Mapping[str, Sequence[Callable[[], str]]]) -> None:
    """Print a table, row by row as it is computed."""
    print("\n|" + "|".join(head) + "|\n|" + "---|" * len(head))
    for name, cells in rows.items():
        print(f"|{name}|" + "|".join(cell() for cell in cells) + "|", flush=True)


def machines() -> None:
    """Machines that the controller does not know."""
    ways = [(path, play) for path in PAIR for play in (NONE, KNOWN)]
    rows = {n: [partial(error, "lumped", p, g | h) for p, h in ways] for n, g in OTHERS.items()}
    for name, path in (("1 m/s", "fast"), ("5 m at 5 m in front", "far")):
        rows[name] = [partial(error, "lumped", path, h) for h in (NONE, KNOWN)]
    table(("machine", "line, no hysteresis", "4 %", "square, no hysteresis", "4 %"), rows)
    small = drives("valve_area", 3.2e-5) | NONE
    rows = {
        f"valves 20 % smaller, swing_integral_gain {k}": [
            partial(error, "lumped", p, small | {"controller.swing_integral_gain": k}) for p in PAIR
        ]
        for k in (5, 10)
    }
    known = {"controller.valve_dead_band": 0.5, "controller.swing_valve_dead_band": 0.5}
    rows["detailed, 0.5 V assumed"] = [partial(error, "detailed", p, known | KNOWN) for p in PAIR]
    rows["the same without hysteresis"] = [partial(error, "detailed", p, known | NONE) for p in PAIR]
    rows["detailed, -10 °C"] = [partial(error, "detailed", p, oil(-10) | KNOWN) for p in PAIR]
    table(("for the sentences", *PAIR), rows)


def heads() -> None:
    """The load-sensing machine."""

    def row(given: Start) -> list[Callable[[], str]]:
        return [partial(error, "compensated", p, given | h) for p in PAIR for h in (NONE, KNOWN)]

    rows = {f"{m} kg": row({"manipulator.head_mass": m}) for m in (350, 500, 700, 900)}
    rows["900 kg, narrow edge"] = row(
        {"manipulator.head_mass": 900, "boom_stick.boom_head_return_area": 21e-6}
    )
    table(("head", "line, no hysteresis", "4 %", "square, no hysteresis", "4 %"), rows)


def sensors() -> None:
    """Sampled every 10 and 20 ms, with as much of a delay; valves without hysteresis."""
    rows = {
        name: [
            partial(error, kind, path, given | NONE, seen)
            for seen in (None, opener, partial(opener, kind=Slower))
        ]
        for name, kind, path, given in SEEN
    }
    table(("machine", "ideal", "10 ms, noise", "20 ms, noise"), rows)


def plays() -> None:
    """Hysteresis of the valves, with sensors."""
    columns = [(kind, path) for kind in KINDS for path in PAIR]
    rows = {name: [partial(error, k, p, given, opener) for k, p in columns] for name, given in PLAYS.items()}
    table(("hysteresis", *(f"{kind}, {path}" for kind, path in columns)), rows)


def stop() -> None:
    """Peak-to-peak motion of the tip [mm] after it was engaged at full swing, sideways and upwards."""
    time = np.array([0, 0.5, 1, 2, 2.001, 14.0])
    inputs = {
        "boom_lever": [0, 0, 4, 4, 4, 4],
        "swing_lever": [0, 0, 5, 5, 5, 5],
        "engaged": [0, 0, 0, 0, 1, 1],
    }
    wanted = Trace(time, {f"controller.{n}": np.array(v, float) for n, v in inputs.items()})
    seconds = (3, 4, 6, 8, 10, 12)

    def row(kind: str, given: Start) -> list[Callable[[], str]]:
        trace = run(SYSTEM, wanted, parameters=["nominal"], swap=KINDS[kind], set=given, record=TIP,
                    record_step=0.01).trace  # fmt: skip
        last = [(trace.time > 2 + s - 1) & (trace.time <= 2 + s) for s in seconds]
        moved = [[1e3 * np.ptp(trace[n][rows]) for n in (TIP[0], TIP[2])] for rows in last]
        return [partial(", ".join, [f"{x:.0f}" if x >= 1 else f"{x:.1f}" for x in pair]) for pair in moved]

    table(
        ("machine", "3rd second", *(f"{s}th" for s in seconds[1:])), {n: row(*of) for n, of in STOPS.items()}
    )


def loop() -> None:
    """Damping and frequency [Hz] of the slow mode of the stretched arm that turns at 0.4 rad/s."""

    def mode(rate: float, integral: float, load: float) -> str:
        gains = {"damping_rate": rate, "integral_gain": integral, "load_time": load}
        given = {f"controller.swing_{n}": float(v) for n, v in gains.items()} | NONE
        given |= {"engaged": 1.0, "swing_velocity": 0.4}
        modes = linearize(SYSTEM, parameters=["reach"], set=given, time=4.0).modes
        slow = (m for m in modes if m.name.startswith("oscillation of swing") and m.frequency < 2)
        least = min(slow, key=lambda m: m.damping)
        return f"{least.damping:.3f}|{least.frequency:.2f}"

    rows = {"|".join(f"{v:g}" for v in of): [partial(mode, *of)] for of in LOOPS}
    table(("`swing_damping_rate`", "`swing_integral_gain`", "`swing_load_time`", "damping", "at [Hz]"), rows)


TABLES = {
    "machines": machines, "heads": heads, "sensors": sensors, "hysteresis": plays, "stop": stop, "loop": loop,
}  # fmt: skip


def main() -> None:
    """Print the tables that are named, or all."""
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()


if __name__ == "__main__":
    main()
