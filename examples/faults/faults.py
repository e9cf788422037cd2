"""What an operator sees of each fault: `python examples/faults/faults.py`, after
`harvester build --faults --fmi 2 --out build/faults`.

Each machine does the work cycle, healthy and with a fault from 10 or 11 s on. The picture is written to
build/faults.png, or to the file that is given.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from orchestrator import Result, run
from orchestrator.pages.figures import PALETTE
from orchestrator.pages.plotting import new_figure, png, style_axes

SYSTEM = "build/faults/harvester_actuation.ssp"
BEGIN, STOP = 10.0, 30.0  # s
DETAILED = {"swing": "detailed", "boom_stick": "detailed"}
SENSING = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}


@dataclass(frozen=True)
class Case:
    """A fault, its size, and the signal that tells of it: name, text, its unit over the SI unit."""

    title: str
    fault: str
    size: str
    signal: str
    text: str
    scale: float = 1.0
    swap: dict[str, str] = field(default_factory=dict)
    begin: float = BEGIN


BAR, DEGREE, LITRE = 1e-5, 57.29578, 6e4
BOOM = ("manipulator.boom_angle", "boom angle [deg]", DEGREE)
CASES = (
    Case("fitting of the boom leaks", "boom_head_leak", "0.5mm2", *BOOM),
    Case("hose of the boom bursts", "boom_head_leak", "50mm2", *BOOM),
    Case("seals of the boom cylinder leak", "boom_seal_leakage", "2e-12", *BOOM),
    Case("boom spool sticks", "boom_spool_stuck", "1", *BOOM),
    Case(
        "no current at the stick valve",
        "stick_driver_loss",
        "1",
        "manipulator.stick_angle",
        "stick angle [deg]",
        DEGREE,
    ),
    Case(
        "stick valve: 15 % more hysteresis",
        "stick_hysteresis_added",
        "0.15",
        "manipulator.stick_angle",
        "stick angle [deg]",
        DEGREE,
    ),
    Case(
        "pilot filter clogs",
        "pilot_filter_clogging",
        "20",
        "valve_actuation.boom_valve_command",
        "boom spool [V]",
    ),
    Case(
        "line of the swing leaks",
        "swing_leak_a",
        "5mm2",
        "manipulator.swing_angle",
        "swing angle [deg]",
        DEGREE,
    ),
    Case(
        "pumps are worn",
        "pump_wear",
        "3e-11",
        "supply.supply_pressure",
        "supply [bar]",
        BAR,
        {"supply": "engine_pump"},
    ),
    Case(
        "return filter clogs",
        "filter_clogging",
        "4e8",
        "supply.tank_pressure",
        "return [bar]",
        BAR,
        {"supply": "engine_pump"},
    ),
    Case(
        "cooler fails",
        "cooler_loss",
        "1",
        "supply.oil_temperature",
        "oil [K]",
        1.0,
        {"supply": "engine_pump"},
    ),
    Case(
        "air in the oil",
        "boom_stick_air",
        "0.1",
        "boom_stick.boom_head_pressure",
        "boom, head [bar]",
        BAR,
        DETAILED,
    ),
    Case(
        "port relief valves set too low",
        "boom_stick_relief_loss",
        "0.6",
        "boom_stick.stick_rod_pressure",
        "stick, rod [bar]",
        BAR,
        DETAILED,
    ),
    Case("counterbalance valves set too low", "boom_stick_counterbalance_loss", "0.7", *BOOM, SENSING),
    Case("boom spool sticks while it is open", "boom_spool_stuck", "1", *BOOM, begin=11.0),
)


def results() -> Iterator[tuple[Case, Result, Result]]:
    """Each case, healthy and with its fault."""
    healthy = dict[tuple[tuple[str, str], ...], Result]()
    for case in CASES:
        machine = tuple(sorted(case.swap.items()))
        if machine not in healthy:
            healthy[machine] = run(SYSTEM, stop=STOP, swap=case.swap, record_step=0.01)
        fault = {case.fault: f"{case.size}@{case.begin:g}s"}
        yield case, healthy[machine], run(SYSTEM, stop=STOP, swap=case.swap, fault=fault, record_step=0.01)


def main() -> None:
    """Run, print the largest change of each signal, draw."""
    figure = new_figure(12, 12.5)
    plots = figure.subplots(5, 3).ravel()
    for axes, (case, healthy, faulty) in zip(plots, results(), strict=True):
        style_axes(axes, y=case.text)
        for result, colour, label in (
            (healthy, PALETTE.faint, "healthy"),
            (faulty, PALETTE.colour(1), "with the fault"),
        ):
            axes.plot(result.time, case.scale * result[case.signal], color=colour, linewidth=1.6, label=label)
        axes.set_title(case.title, loc="left", fontsize=9)
        axes.axvline(case.begin, color=PALETTE.faint, linewidth=0.8, linestyle=":")
        change = case.scale * abs(faulty[case.signal] - healthy[case.signal]).max()
        print(f"{case.title}: --fault {case.fault}={case.size}@{case.begin:g}s: {case.text} by {change:.3g}")
    plots[0].legend(fontsize=8)
    for axes in plots[-3:]:
        axes.set_xlabel("time [s]", fontsize=9)
    file = Path(*(sys.argv[1:] or ["build/faults.png"]))
    file.write_bytes(png(figure))
    print(file)


if __name__ == "__main__":
    main()
