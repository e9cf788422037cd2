"""The README.md beside the recordings: what they are, how they were made, with which instruments."""

from __future__ import annotations

from fmus.rig import instruments
from fmus.rig.instruments import Instrument
from fmus.rig.plans import MACHINES

HEADING = "# Recordings of the virtual test rig"

_TEXT = """{heading}

**Simulated.** No machine was measured: the signals come from the project's own equations, with the noise
and the converters of instruments added. They stand in for the paper's recordings, which are not public.

| | |
|---|---|
| machine | {machine}: {variants} |
| seed of the noise | {seed} |
| made by | `harvester rig --machine {machine} --seed {seed} --out DIR` |
| rate | 200 Hz, raw: no filter |

Each NAME.csv is described by its NAME.toml: what was done, the columns with their units, the instruments.

| files | experiment (paper, section 4) |
|---|---|
| valve_pa, valve_bt, valve_pb, valve_at | (a) one metering edge of the valve at stepped commands |
| hose_resistance | (b) the 4 m hose at stepped flows |
| hose_dynamics_1 to _4 | (c) the same hose, fast changes: four groups |
| motor_leakage_1, _2 | (d) the swing motor, shaft locked, pressure stepped at port A, then at port B |
| damping_JOINT_1, _2 | (d) the machine, one joint moves |
| machine_train_1, _2 | the machine, all axes move |
| machine_test | section 5: a work cycle, held out from fitting (`use = "test"`) |

| instrument | noise (standard deviation) | step | range | reads 0 below |
|---|---|---|---|---|
{table}

Commands are what the computer sent: known exactly. White noise, a step of the converter, a range and a
dead zone are all that the instruments do: they have no error of zero or gain, no delay and no drift, dead
zones have sharp ends, and the clock is exact. Real instruments are worse.
"""


def readme(machine: str, seed: int) -> str:
    """The text for one folder of recordings."""
    shown = (instruments.PRESSURE, instruments.FLOW, instruments.LEAKAGE, instruments.ANGLE)
    return _TEXT.format(
        heading=HEADING,
        machine=machine,
        variants=MACHINES[machine],
        seed=seed,
        table="\n".join(map(_row, shown)),
    )


def _row(i: Instrument) -> str:
    ends = f"{i.low:g} to {i.high:.6g} {i.unit}" if i.high < float("inf") else "none"
    dead = f"{i.dead_zone:g} {i.unit}" if i.dead_zone else "-"
    return f"| {i.text} | {i.noise:g} {i.unit} | {i.step:.4g} {i.unit} | {ends} | {dead} |"
