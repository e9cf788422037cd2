"""Fits valve, chamber and bending arm to a file of valve command and pressure without units; see README.md.

python examples/grey_box/run.py [FILE COMMAND PRESSURE [PICTURE]]  # columns by name or by index from 0"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
from dimensionless import all_free, blank, dimensionless, normalised, series

from fmus.components import chamber, spool_valve
from fmus.identification.recordings.masks import good
from fmus.identification.recordings.reading import split
from fmus.identification.refinement.refine import refine
from fmus.identification.refinement.statistics import nrmse
from orchestrator.base.errors import Problem

CRANE = Path(__file__).with_name("crane.txt")
START = dict(area_up=0.3, full_up=0.5, area_down=0.3, full_down=0.5, dead_band=0.05, lag=3.0, supply=3.0)
START |= dict(friction=1.0, stiffness=2.0, inertia=10.0)
STATES = ["pressure", "spool", "force", "speed"]


def rates(x, u, p):
    """Times in samples, signals in their peaks, volumes in what raises the chamber by one peak."""
    up = p.area_up * spool_valve.opening(x.spool, 0, p.full_up, 2 * p.dead_band)
    down = p.area_down * spool_valve.opening(-x.spool, 0, p.full_down, 2 * p.dead_band)
    drops = p.supply - x.pressure, p.supply + x.pressure  # roots, which are linear below 0.01
    flow = up * drops[0] / (drops[0] ** 2 + 1e-4) ** 0.25 - down * drops[1] / (drops[1] ** 2 + 1e-4) ** 0.25
    joint = (x.pressure - x.force) / p.friction  # speed at which the arm is driven
    pressure = chamber.pressure_rate(x.pressure, flow - joint, 1)
    force, speed = p.stiffness * (joint - x.speed), x.force / p.inertia  # the arm bends and swings
    return dict(pressure=pressure, spool=(u.command - x.spool) / p.lag, force=force, speed=speed)


def main(path=CRANE, command=0, pressure=1, picture=""):
    data = series(path, {"command": command, "pressure": pressure})
    bad = ~good(data, "pressure")  # gaps, and samples at an end of the sensor's range
    data, peaks = normalised(blank(data, "pressure", bad))
    model = dimensionless("grey_box", START, ["command"], STATES, rates, {"spool": "command"})
    result = refine(all_free(model, *split(data, len(data.time) // 2)), segment=64)  # fits the first half
    for e in result.estimates():
        interval = f"{e.low:.4f} to {e.high:.4f}" if e.high < 1e9 else "open"
        print(f"{e.name:10} {e.value:8.4f}, 95 %: {interval}")
    print(f"{bad.sum()} samples masked; search ended: {result.reason}", *result.unidentified, sep="\n")
    plt.figure(figsize=(12, 4))
    plt.plot(data.time, data["pressure"] * peaks["pressure"], "k", label="recorded")
    for half, simulated in (("fit", result.training[0]), ("held out", result.held_out[0])):
        error, span = nrmse([simulated])[0], abs(simulated.run.scale[0] * peaks["pressure"])
        doubt = ": the model does not fit, are the columns right?" * (not error < 0.1)
        print(f"{half}: RMSE {error * span:.3f} in the file's numbers, NRMSE {100 * error:.1f} %{doubt}")
        plt.plot(simulated.run.time, simulated.y * peaks["pressure"], label=half)
    plt.legend()
    plt.savefig(picture or f"{data.source.stem}.png", dpi=80)


try:
    main(*(int(word) if word.isdigit() else word for word in sys.argv[1:]))
except Problem as error:
    sys.exit(f"error: {error}" + " (run.py FILE COMMAND PRESSURE)" * (len(sys.argv) < 4))
