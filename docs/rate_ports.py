"""Draws docs/images/rate-ports.png and prints the table of docs/rate-ports.md: `python docs/rate_ports.py`.

The machine from harvester.ssp in Ecos and in FMPy, plain Jacobi masters, over the step; with its rate ports
connected and open. Needs ecospy (on Debian with libtbb12).
"""

from __future__ import annotations

import contextlib
import io
import re
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import ecospy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.ssp.simulation import simulate_ssp
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmus.machine.build import data, harvester

IMAGE = Path(__file__).parent / "images" / "rate-ports.png"
SPEEDS = tuple(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick"))
STOP, SAMPLE = 42.0, 0.04  # s; the reference has a sample every 20 ms, all steps have one every 40 ms
STEPS = {"Ecos": (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 8e-3, 1e-2), "FMPy": (1e-3, 2e-3, 5e-3)}
BAR, LOST = 0.5, 100.0  # % of range: what the project asks for, and where nothing is left to compare
INK, BLUE, RED = "#1c2024", "#06406b", "#c2341d"
Signals = dict[str, np.ndarray]


def main() -> None:
    """Run everything, draw, print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        harvester().write(folder)
        connected = folder / "harvester.ssp"
        systems = {"connected": connected, "open": without_rates(connected, folder / "held.ssp")}
        errors = {
            (tool, rates): {h: error(TOOLS[tool], system, h) for h in STEPS[tool]}
            for tool in STEPS
            for rates, system in systems.items()
        }
        stick = {rates: in_ecos(s, 1e-3, 10.0, 5e-3)[SPEEDS[2]] for rates, s in systems.items()}
    draw(errors, stick)
    print_table(errors)


def without_rates(system: Path, target: Path) -> Path:
    """A copy of an SSP without the connections of the rate ports."""
    port = rb'<ssd:Connection [^>]*endConnector="\w*_(?:rate|acceleration)"[^>]*?(?:/>|>.*?</ssd:Connection>)'
    with zipfile.ZipFile(system) as whole, zipfile.ZipFile(target, "w") as part:
        for name in whole.namelist():
            content = whole.read(name)
            part.writestr(name, re.sub(port, b"", content, flags=re.S) if name.endswith(".ssd") else content)
    return target


# ---- the tools -------------------------------------------------------------------------------------


def in_ecos(system: Path, step: float, stop: float = STOP, sample: float = SAMPLE) -> Signals:
    """Joint speeds, the first sample one interval after the start."""
    ecospy.EcosLib.set_log_level("off")
    names = [name.replace(".", "::") for name in SPEEDS]
    with ecospy.EcosSimulation(ssp_path=str(system), step_size=step) as simulation:
        simulation.init()
        rows = []
        for _ in range(round(stop / sample)):
            simulation.step(round(sample / step))
            rows.append([simulation.get_real(name) for name in names])
        simulation.terminate()
    return dict(zip(SPEEDS, np.array(rows).T, strict=True))


def in_fmpy(system: Path, step: float) -> Signals:
    """The same; an FMU whose states leave the range of the model ends the run."""
    with contextlib.redirect_stdout(io.StringIO()):  # the FMUs warn of cavitation
        try:
            rows = simulate_ssp(str(system), stop_time=STOP, step_size=step)
        except FMICallException:
            return {name: np.full(round(STOP / SAMPLE), np.nan) for name in SPEEDS}
    every = round(SAMPLE / step)  # row n is what FMPy has after n + 1 steps
    return {name: rows[name][every - 1 :: every] for name in SPEEDS}


TOOLS: Mapping[str, Callable[[Path, float], Signals]] = {"Ecos": in_ecos, "FMPy": in_fmpy}


def reference() -> Signals:
    """The monolithic solution after the start."""
    path = data("reference/work_cycle.csv")
    names = path.read_text(encoding="utf-8").partition("\n")[0].strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=2).T, strict=True))


def error(tool: Callable[[Path, float], Signals], system: Path, step: float) -> float:
    """Worst root mean square error of a joint speed over its range [%]; infinite where the run is lost."""
    found, true = tool(system, step), reference()
    squares = {n: np.mean((found[n] - true[n][1::2]) ** 2) for n in SPEEDS}
    worst = max(100 * float(np.sqrt(squares[n]) / np.ptp(true[n])) for n in SPEEDS)
    return worst if worst < LOST else np.inf


# ---- figure and table ------------------------------------------------------------------------------

Errors = Mapping[tuple[str, str], Mapping[float, float]]


def draw(errors: Errors, stick: Mapping[str, np.ndarray]) -> None:
    """Error over step, and the stick at 1 ms."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    _errors(left, errors)
    _trace(right, stick)
    for axes in (left, right):
        axes.grid(color="#dfe2e6", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(IMAGE, dpi=130)


def _errors(axes: Axes, errors: Errors) -> None:
    styles = {
        "Ecos": {"marker": "o", "linewidth": 1.4},
        "FMPy": {"marker": "s", "linestyle": "none", "ms": 8},
    }
    for (tool, rates), found in errors.items():
        color = BLUE if rates == "connected" else RED
        style = styles[tool] | {"color": color, "markerfacecolor": color if tool == "Ecos" else "none"}
        values = np.minimum([*found.values()], LOST)
        axes.plot(np.array([*found]) * 1e3, values, label=f"{tool}, rate ports {rates}", **style)
    axes.axhline(BAR, color=INK, linewidth=0.8, linestyle="--")
    axes.text(0.1, BAR * 1.15, f"{BAR} %", color=INK, fontsize=8)
    axes.text(0.1, LOST * 0.62, "diverges", color=INK, fontsize=8)
    axes.set(xscale="log", yscale="log", ylim=(4e-5, 180), xlabel="communication step [ms]")
    axes.set_ylabel("worst joint speed, NRMSE [%]")
    axes.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    axes.legend(loc="lower right", fontsize=8, frameon=False)


def _trace(axes: Axes, stick: Mapping[str, np.ndarray]) -> None:
    time = np.arange(1, len(stick["connected"]) + 1) * 5e-3
    true = reference()
    axes.plot(time, stick["open"], color=RED, linewidth=0.8, label="Ecos at 1 ms, rate ports open")
    axes.plot(true["time"], true[SPEEDS[2]], color="#7db7dc", linewidth=4, label="monolithic reference")
    axes.plot(time, stick["connected"], color=BLUE, linewidth=1, label="Ecos at 1 ms, rate ports connected")
    axes.set(xlim=(5, 10), ylim=(-0.6, 0.6), xlabel="time [s]", ylabel="stick speed [rad/s]")
    axes.legend(loc="lower left", fontsize=8, frameon=False)


def print_table(errors: Errors) -> None:
    """The table of the page."""
    steps = sorted({h for found in errors.values() for h in found})
    print("||" + "".join(f"{1e3 * h:.3g} ms|" for h in steps))
    print("|---|" + "---|" * len(steps))
    for (tool, rates), found in errors.items():
        texts = {h: "diverges" if np.isinf(e) else f"{e:.2g} %" for h, e in found.items()}
        cells = [texts.get(h, "") for h in steps]
        print(f"|{tool}, rate ports {rates}|" + "|".join(cells) + "|")


if __name__ == "__main__":
    main()
