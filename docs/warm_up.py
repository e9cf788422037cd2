"""Warm-up of the load-sensing machine: work cycles one after another in a cold morning.

    python docs/warm_up.py

draws images/warm-up.png and fills in the table of docs/machine.md. Oil and air have -10 degC at the
start; the thermostat of the cooler opens at 50 degC.
"""

from pathlib import Path

import numpy as np
from convergence import fill
from matplotlib.figure import Figure

from fmus.operator_input.work_cycle import COMMANDS, DEFAULT, PROGRAMS, WORK_CYCLE_STOP, sample
from orchestrator import Trace, run
from orchestrator.pages.plotting import png

SYSTEM = Path(__file__).parents[1] / "build/harvester.ssp"
PAGE = Path(__file__).with_name("machine.md")
FILE = Path(__file__).with_name("images") / "warm-up.png"
HEAD = (
    "|cycle|time [min]|oil [°C]|viscosity [mm2/s]"
    "|from the engine [kW]|into the drives [kW]|cooler and tank [kW]|"
)
SWAP = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}
COLD = 263.15  # K
CYCLES, STEP = 84, 1.0  # s between the samples
SHOWN = (1, 2, 5, 10, 20, 40, 84)  # cycles in the table
SIGNALS = (
    *("supply.oil_temperature", "supply.oil_viscosity", "supply.engine_power", "supply.hydraulic_power"),
    "supply.cooling_power",
)


def warmed_up(cycles: int = CYCLES, system: Path = SYSTEM) -> Trace:
    """Signals of so many work cycles, one after another."""
    time, commands = sample(PROGRAMS[DEFAULT], WORK_CYCLE_STOP)
    starts = WORK_CYCLE_STOP * np.arange(cycles)
    scenario = {"time": (starts[:, None] + time[:-1]).ravel()}
    scenario |= {name: np.tile(c[:-1], cycles) for name, c in zip(COMMANDS, commands.T, strict=True)}
    cold = {"supply.oil_temperature_start": COLD, "supply.ambient_temperature": COLD}
    stop = cycles * WORK_CYCLE_STOP
    return run(system, scenario, swap=SWAP, set=cold, stop=stop, record=[*SIGNALS], record_step=STEP).trace


def rows(trace: Trace) -> list[tuple[float, ...]]:
    """Of each cycle: its end [min], temperature [degC], viscosity [mm2/s] there, mean power [kW]."""
    found = []
    for cycle in range(1, int(trace.time[-1] / WORK_CYCLE_STOP) + 1):
        inside = (trace.time > (cycle - 1) * WORK_CYCLE_STOP) & (trace.time <= cycle * WORK_CYCLE_STOP)
        theta, nu, engine, drives, cooled = (trace[name][inside] for name in SIGNALS)
        means = (p.mean() / 1e3 for p in (engine, drives, cooled))
        found.append((cycle * WORK_CYCLE_STOP / 60, theta[-1] - 273.15, nu[-1] * 1e6, *means))
    return found


def picture(trace: Trace) -> Figure:
    """Temperature and viscosity, and power, over time."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    upper, lower = figure.subplots(2, sharex=True)
    minutes = trace.time / 60
    upper.plot(minutes, trace["supply.oil_temperature"] - 273.15, color="C3")
    upper.set(ylabel="oil temperature [°C]", title="Work cycles one after another, from -10 °C")
    right = upper.twinx()
    right.semilogy(minutes, trace["supply.oil_viscosity"] * 1e6, color="C0")
    right.set_ylabel("viscosity [mm²/s]", color="C0")
    end, _, _, engine, drives, cooled = zip(*rows(trace), strict=True)
    for label, power in (("engine", engine), ("into the drives", drives), ("to the air", cooled)):
        lower.plot(end, power, ".-", label=label)
    lower.set(xlabel="time [min]", ylabel="mean of a cycle [kW]", ylim=(0, None))
    lower.legend()
    return figure


def table(trace: Trace) -> str:
    """Rows of the cycles `SHOWN`."""
    found = rows(trace)
    shown = (f"|{cycle}|" + "|".join(f"{value:.3g}" for value in found[cycle - 1]) + "|" for cycle in SHOWN)
    return "\n".join((HEAD, "|---" * 7 + "|", *shown))


if __name__ == "__main__":
    run_trace = warmed_up()
    FILE.write_bytes(png(picture(run_trace)))
    print(table(run_trace))
    fill(PAGE, "warm-up", table(run_trace))
