"""Makes work cycle, reference trace, levers' program, and the experiments that FMUs carry as their proof.

    python -m fmus.reference DATA_FOLDER

The trace comes from the monolithic model (`fmus.monolith`), which shares no coupling and no solver with FMUs.
Its meta file, `data/reference/work_cycle.toml`, is written by hand and says why the trace changed last.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus import experiment
from fmus.levers import LEVERS
from fmus.machine import CONNECTIONS, INPUTS, SUBSYSTEMS
from fmus.monolith import join, simulate
from fmus.parameters import write
from fmus.scenarios import COMMANDS, WORK_CYCLE, WORK_CYCLE_STOP, program_numbers, sample
from fmus.tables import write_csv

TOLERANCE = 1e-11  # relative, of CVODES
EVERY = 4  # the trace keeps every 4th sample: 50 Hz, above twice the fastest structural mode (17 Hz)
SIGNALS = (
    *("swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"),
    *(f"manipulator.{joint}_{kind}" for kind in ("angle", "speed") for joint in ("swing", "boom", "stick")),
    *("manipulator.boom_position", "manipulator.stick_position"),
    *(
        "manipulator.elbow_radius",
        "manipulator.elbow_height",
        "manipulator.tip_radius",
        "manipulator.tip_height",
    ),
    *("swing.swing_pressure_a", "swing.swing_pressure_b", "swing.swing_flow_a", "swing.swing_flow_b"),
    *(
        f"boom_stick.{a}_{side}_{kind}"
        for kind in ("pressure", "flow")
        for a in ("boom", "stick")
        for side in ("head", "rod")
    ),
    *("swing.swing_torque", "boom_stick.boom_force", "boom_stick.stick_force"),
)


def work_cycle() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (n,) and commands (n, 3) of the work cycle, rounded so that ten digits hold them."""
    time, commands = sample(WORK_CYCLE, WORK_CYCLE_STOP)
    return time, np.round(commands, 9)


def trace() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (n,) and SIGNALS (n, m) of the monolithic model over the work cycle, at 200 Hz."""
    time, commands = work_cycle()
    model = join(SUBSYSTEMS, CONNECTIONS, INPUTS)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(name) for name in COMMANDS]] = commands
    _, outputs = simulate(model, time, inputs, tolerance=TOLERANCE)
    driven = {
        target: inputs[:, model.inputs.index(name)] for name, targets in INPUTS.items() for target in targets
    }
    known = driven | dict(zip(model.output_names, outputs.T, strict=True))
    return time, np.column_stack([known[name] for name in SIGNALS])


def main(folder: Path) -> None:
    """Write scenario and trace below `folder`; the levers' program and experiments beside the models."""
    write(LEVERS.values, program_numbers())
    time, commands = work_cycle()
    write_csv(
        folder / "scenarios" / "work_cycle.csv", ("time", *COMMANDS), np.column_stack([time, commands]), 10
    )
    time, signals = trace()
    kept = np.column_stack([time, signals])[::EVERY]
    write_csv(folder / "reference" / "work_cycle.csv", ("time", *SIGNALS), kept, 9)
    experiment.main()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
