"""Lowering the boom behind counterbalance valves: power and oscillation over pilot ratio and meter-out edge.

    python docs/counterbalance.py

fills in the tables of docs/equations.md, section 4.8, and draws images/counterbalance.png. The head is empty.
The boom is lowered at full command for the power and with 2.5 V for the oscillation; the first table has the
load-sensing machine from the pose `folded`, the second also other poses and the ideal supply.
"""

import sys
from pathlib import Path

import numpy as np
from convergence import fill
from matplotlib.figure import Figure

from orchestrator import Trace, run
from orchestrator.pages.plotting import png

SWAP = {"boom_stick": "compensated", "swing": "compensated", "supply": "load_sensing"}
CASES = tuple((s, p) for s in ("load_sensing", "ideal") for p in ("folded", "raised", "reach"))
RATIOS = (1.5, 3.0, 4.5)
WIDE, NARROW = 6.6e-5, 2.1e-5  # m2
PAGE = Path(__file__).with_name("equations.md")
FILE = Path(__file__).with_name("images") / "counterbalance.png"
SIGNALS = {
    "speed": "manipulator.boom_velocity",
    "supply": "supply.supply_pressure",
    "flow": "boom_stick.boom_meter_in_flow",
    "pilot": "boom_stick.boom_rod_valve_pressure",
}


def lowered(
    ratio: float,
    area: float,
    command: float,
    stop: float,
    system: str = "build/harvester.ssp",
    case: tuple[str, str] = CASES[0],
) -> Trace:
    """Signals of the boom, lowered from 0.5 s on; case: supply and pose."""
    supply, pose = case
    time = np.array([0.0, 0.5, 0.8, stop])
    scenario = {"time": time, "boom_command": np.array([0.0, 0.0, -command, -command])}
    changed = {"boom_stick.boom_head_pilot_ratio": ratio, "boom_stick.boom_head_return_area": area}
    swap = {part: variant for part, variant in (SWAP | {"supply": supply}).items() if variant != "ideal"}
    options = {"parameters": [pose], "swap": swap, "set": changed, "stop": stop}
    return run(system, scenario, record=[*SIGNALS.values()], record_step=5e-3, **options).trace


def power(trace: Trace) -> tuple[float, float, float]:
    """Means of the last 0.7 s: supply pressure [Pa], pilot pressure [Pa], power [W] of the boom section.

    That is two periods of the slowest oscillation: with elastic hoses it does not decay within a stroke.
    """
    late = trace.time > trace.time[-1] - 0.7
    supply, flow, pilot = (trace[SIGNALS[n]][late] for n in ("supply", "flow", "pilot"))
    return float(supply.mean()), float(pilot.mean()), float((supply * flow).mean())


def ripple(trace: Trace, start: float, stop: float) -> float:
    """Standard deviation of the piston speed less a parabola, over its mean."""
    at = (trace.time >= start) & (trace.time < stop)
    time, speed = trace.time[at], trace[SIGNALS["speed"]][at]
    return float(np.std(speed - np.polyval(np.polyfit(time, speed, 2), time)) / abs(speed.mean()))


def row(ratio: float, area: float, slow: Trace) -> str:
    """Row of the table; slow: the boom lowered with 2.5 V."""
    supply, pilot, watts = power(lowered(ratio, area, 10.0, 2.2))
    early, late = ripple(slow, 1.0, 2.0), ripple(slow, 3.5, 4.5)
    pressures = f"{supply / 1e5:.0f} bar|{pilot / 1e5:.0f} bar|{watts / 1e3:.0f} kW"
    return f"|{area * 1e6:.0f} mm2|{ratio:g}|{pressures}|{early:.1%}|{late:.1%}|"


def main() -> None:
    """Fill in the tables and draw the picture."""
    rows = ["|edge|pilot ratio|supply|pilot|power|oscillation after 1 s|after 3.5 s|", "|---" * 7 + "|"]
    cases = ["|edge|pilot ratio|" + "|".join(f"{s}, `{p}`" for s, p in CASES) + "|", "|---" * 8 + "|"]
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.add_subplot()
    for area, ratio in ((NARROW, 4.5), *((WIDE, r) for r in RATIOS)):
        slow = lowered(ratio, area, 2.5, 4.5)
        rows.append(row(ratio, area, slow))
        others = (lowered(ratio, area, 2.5, 4.5, case=case) for case in CASES[1:])
        left = "|".join(f"{ripple(trace, 3.5, 4.5):.0%}" for trace in (slow, *others))
        cases.append(f"|{area * 1e6:.0f} mm2|{ratio:g}|{left}|")
        axes.plot(
            slow.time, slow[SIGNALS["speed"]], label=f"{area * 1e6:.0f} mm2, {ratio:g} : 1", linewidth=1
        )
    axes.set(xlabel="time [s]", ylabel="speed of the boom piston [m/s]")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    for name, lines in (("counterbalance", rows), ("counterbalance-cases", cases)):
        print("\n".join(lines))
        fill(PAGE, name, "\n".join(lines))
    FILE.write_bytes(png(figure))


if __name__ == "__main__":
    sys.exit(main())
