"""Compares the crane of patu.toml with the measurement that its authors published, and draws both.

    git clone https://github.com/qkhadim22/DeepMechDyn
    python examples/cranes/patu.py DeepMechDyn

The curves are those of the vector pictures in this folder. docs/patu.md has the results.
"""

from __future__ import annotations

import argparse
import re
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.io
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmus.crane.description import read
from fmus.crane.machine import crane_build
from fmus.machine.one_block import one_block
from orchestrator import Result, run

Array = NDArray[np.float64]
Signals = Mapping[str, Array]
FOLDER, MODEL = "rigidMBD-PVG32/figures", "rigidMBD-PVG32/MATLABCode/data/PVG32_flow_assymetricDB.mat"
MEASURED, SIMULATED = "0 0.270588235 0.549019607 SCN", "0 0.450980392 0.200000000 SCN"
# ends of the vertical axis of the picture of a signal [V, bar, mm, deg], as in run_PATU_model.m of the folder
LIMITS = {"U1": (3.5, 7.5), "U2": (3.5, 7.5), "pP": (88, 96), "pT": (0.8, 1.2), "s1": (900, 1250)}
LIMITS |= {"s2": (1200, 1350), "z1": (-5, 55), "p1": (40, 90), "p2": (-10, 40), "p3": (0, 15), "p4": (25, 40)}
ROWS = {
    "s1": ("lift piston [mm]", "lift_position", 1e3, 820.0),
    "s2": ("tilt piston [mm]", "tilt_position", 1e3, 1050.0),
    "z1": ("lift angle [deg]", "lift_angle", 180 / np.pi, 0.0),
    "p1": ("lift, head [bar]", "lift_head_pressure", 1e-5, 0.0),
    "p2": ("lift, rod [bar]", "lift_rod_pressure", 1e-5, 0.0),
    "p3": ("tilt, head [bar]", "tilt_head_pressure", 1e-5, 0.0),
    "p4": ("tilt, rod [bar]", "tilt_rod_pressure", 1e-5, 0.0),
}
FORCES = {"F1": ("lift force [kN]", "p1", "p2"), "F2": ("tilt force [kN]", "p3", "p4")}
AREAS = 25 * np.pi * np.array([0.1**2, -(0.1**2 - 0.056**2)])  # kN/bar
TIMES = np.arange(0, 27, 5e-3)
REST, FIRST = TIMES < 0.5, TIMES < 8.0  # s: start of the record, span of the fit
NEUTRAL, FULL, AREA = 5.6, 3.0, 26.8e-6  # V, V, m2: closed valve, from there to full; valve of patu.toml
# of three valve models in the scripts: Get_parameters_Patu, ..._AssymetricDB_Cav_Dynamic3, ..._Flow_Basic
NEUTRALS = (NEUTRAL, 5.77, 6.0)
# the published valve has neither leakage nor a rounded begin of its opening
SET = {"lift_valve_leakage": 1e-17, "lift_valve_command_rounding": 0.05, "tilt_valve_leakage": 1e-17}
SET |= {"payload_mass": 211.43, "lift_valve_area": AREA}


def curve(folder: Path, name: str, colour: str) -> tuple[Array, Array]:
    """Times [s] and values of a curve in a picture: its vertices over the box of the axes."""
    pictures, (low, high) = sorted((folder / FOLDER).glob(f"{name}_*.pdf")), LIMITS[name]
    if not pictures:
        raise SystemExit(f"{folder}: expected {FOLDER}/{name}_*.pdf, found none")
    content = pictures[0].read_bytes()
    streams = (content[m.end() :] for m in re.finditer(rb"stream\r?\n(?=x)", content))
    pages = (zlib.decompressobj().decompress(x).decode("latin1") for x in streams)
    page = next(x for x in pages if colour in x)
    before, after = page.split(colour, 1)
    vertices = re.findall(r"^(\S+) (\S+) [ml]$", after.split("\nS\n")[0], re.M)
    scale, right, down = map(float, re.findall(r"(\S+) 0 0 \S+ (\S+) (\S+) cm\n", before)[-1])
    corners = r"(\S+) (\S+) [ml]\n" * 3
    x0, top, _, bottom, x1, _ = map(float, re.findall(rf"1 1 1 scn\n(?:/GSa gs\n)?{corners}", page)[1])
    x, y = np.array(vertices, float).T
    x, y = scale * x + right, scale * y + down
    return 35 * (x - x0) / (x1 - x0), high - (high - low) * (y - top) / (bottom - top)


def with_forces(signals: Signals) -> dict[str, Array]:
    """Hydraulic forces of both pistons besides."""
    pairs = {f: np.array([signals[head], signals[rod]]) for f, (_, head, rod) in FORCES.items()}
    return {**signals, **{f: AREAS @ pressures for f, pressures in pairs.items()}}


def simulate(
    fmu: Path, measured: Signals, neutral: float = NEUTRAL, **other: float | None
) -> dict[str, Array]:
    """The crane with the measured commands and supply, and other values of parameters.

    neutral   command of the closed valve [V]
    other     None: the drives have no such parameter
    """
    smooth = np.convolve(np.pad(measured["pP"], 50, mode="edge"), np.full(101, 1 / 101), "valid")
    tank = np.full(TIMES.size, measured["pT"].mean())
    scenario = {"time": TIMES, "supply_pressure": 1e5 * smooth, "tank_pressure": 1e5 * tank}
    for lever, volts in (("lift", "U1"), ("tilt", "U2")):
        scenario[f"{lever}_command"] = 10 * (neutral - measured[volts]) / FULL
    own = {**SET, "initial_preload": 1e5 * measured["p2"][REST].mean(), **other}
    given = {f"patu.{n}": x for n, x in own.items() if x is not None}
    result: Result = run(fmu, scenario, set=given, record_step=5e-3)
    signals = {n: offset + scale * result[f"patu.{s}"] for n, (_, s, scale, offset) in ROWS.items()}
    return with_forces({n: np.interp(TIMES, result.trace.time, x) for n, x in signals.items()})


def size(x: Array) -> tuple[float, float]:
    """Largest magnitude, root mean square."""
    return float(np.max(np.abs(x))), float(np.sqrt(np.mean(x**2)))


def error(fmu: Path, measured: Signals, span: NDArray[np.bool_], **other: float) -> tuple[float, float]:
    """That of the lift piston [mm], maximum and RMS."""
    return size((simulate(fmu, measured, **other)["s1"] - measured["s1"])[span])


def draw(measured: Signals, ours: Mapping[float, Signals], theirs: Signals) -> Figure:
    """A panel for each signal; ours: by the neutral voltage."""
    figure = Figure(figsize=(9, 9), dpi=90, layout="constrained")
    shown = {n: row[0] for n, row in (ROWS | FORCES).items() if n != "z1"}
    for axes, (n, text) in zip(figure.subplots(4, 2, sharex=True).flat, shown.items(), strict=True):
        axes.plot(TIMES, measured[n], color="#8a9099", lw=0.8, label="measured")
        axes.plot(TIMES, theirs[n], color="#c25a00", lw=0.8, ls="--", label="authors' simulation")
        for (volts, found), style in zip(ours.items(), ("-", "-.", ":"), strict=True):
            label = f"FMU, nothing fitted, closed at {volts:g} V"
            axes.plot(TIMES, found[n], style, color="#06406b", lw=1, label=label)
        axes.set_ylabel(text)
        axes.grid(color="#dfe2e6")
    figure.axes[0].legend(fontsize="small")
    figure.supxlabel("time [s]", fontsize="medium")
    return figure


def main() -> None:
    """Build, run, print, draw."""
    parser = argparse.ArgumentParser(description="The crane PATU 655 compared with its measurement.")
    parser.add_argument("folder", type=Path, help="downloaded folder of github.com/qkhadim22/DeepMechDyn")
    folder, fmu = parser.parse_args().folder, Path("build/patu/patu.fmu")
    made, sections = (
        crane_build(read(Path(__file__).with_name("patu.toml"))),
        fmu.parent / "compensated" / fmu.name,
    )
    made.write(fmu.parent, only=(fmu.stem,))
    drives = {"drives": {"compensated": made.machine.parts["drives"]["compensated"]}}
    machine = replace(made.machine, parts={**made.machine.parts, **drives})
    replace(made, whole=one_block(machine, "PATU, compensated")).write(sections.parent, only=(fmu.stem,))
    measured = with_forces({n: np.interp(TIMES, *curve(folder, n, MEASURED)) for n in LIMITS})
    theirs = with_forces({n: np.interp(TIMES, *curve(folder, n, SIMULATED)) for n in ROWS})
    at = {volts: simulate(fmu, measured, volts) for volts in NEUTRALS}
    ours = at[NEUTRAL]
    times, s1 = curve(folder, "s1", SIMULATED)  # from 5 s on, at 1 ms
    exact = 1e3 * scipy.io.loadmat(folder / MODEL)["cylData"][0, 4999 + np.round(1e3 * times).astype(int)]
    print(f"a picture is read to {1e3 * size(s1 - exact)[0]:.2g} um of the lift piston")
    print("                        measured       start     end     max     rms  authors: max    rms")
    for n, (label, *_) in (ROWS | FORCES).items():
        x, e = measured[n], ours[n] - measured[n]
        cells = e[REST].mean(), e[TIMES > 25].mean(), *size(e), *size(theirs[n] - x)
        print(f"{label:18}{x.min():8.1f} to{x.max():7.1f}" + "".join(f"{v:8.2f}" for v in cells))
    for volts, found in at.items():
        (largest, rms), last = size(found["s1"] - measured["s1"]), (found["s1"] - measured["s1"])[-1]
        print(
            f"lift piston, valve closed at {volts:.2f} V: max {largest:.1f} mm, rms {rms:.1f}, end {last:.1f}"
        )
    fit = min(np.r_[0.9:1.1:0.01], key=lambda f: error(fmu, measured, FIRST, lift_valve_area=AREA * f)[1])
    cases = {"as published": {}, f"area times {fit:.2f}, fitted to 0 to 8 s": {"lift_valve_area": AREA * fit}}
    cases["area times 1.1"] = {"lift_valve_area": 1.1 * AREA}
    cases["opening rounded over 0.4 V"] = {"lift_valve_command_rounding": 0.4}
    for text, other in cases.items():
        largest, rms = error(fmu, measured, ~FIRST, **other)
        print(f"lift piston from 8 s on, valve {text}: max {largest:.1f} mm, rms {rms:.1f} mm")
    more, late = simulate(fmu, measured, lift_valve_area=1.1 * AREA), TIMES > 25  # reaches the measured end
    turned = np.mean(np.interp(measured["s1"][late], more["s1"], more["z1"]) - measured["z1"][late])
    print(f"lift angle at the end: {turned:.1f} deg more by pins and measured piston than measured")
    curves = {"measured": measured, "FMU": ours, "authors' simulation": theirs}
    for text, edge in {"": {}, ", edges alike": {"lift_rod_return_area": AREA}}.items():
        for volts in NEUTRALS[:2]:
            name = f"compensated, closed at {volts:.2f} V{text}"
            curves[name] = simulate(sections, measured, volts, lift_valve_area=None, **edge)
            largest, rms = size(curves[name]["s1"] - measured["s1"])
            print(f"lift piston, {name}: max {largest:.1f} mm, rms {rms:.1f} mm")
    for name, x in ((n, of["s1"]) for n, of in curves.items()):
        speeds = (np.polyfit(TIMES[k : k + 600], x[k : k + 600], 1)[0] for k in (1000, 3400))
        print(f"speed of the lift piston, {name}:" + ", ".join(f"{v:6.2f} mm/s" for v in speeds))
    draw(measured, at, theirs).savefig("docs/images/patu.png")


if __name__ == "__main__":
    main()
