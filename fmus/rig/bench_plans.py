"""The experiments on the benches: what is stepped, how far, how long."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from fmus.rig.benches.bench import detailed
from fmus.rig.benches.hose import stick_hose
from fmus.rig.benches.motor import locked_motor
from fmus.rig.benches.valve import EDGES, valve
from fmus.rig.instruments import COMMAND, FLOW, LEAKAGE, PRESSURE, Instrument
from fmus.rig.recording import Array, Condition, Experiment
from fmus.rig.schedule import levels, up_and_down

HOLD = 2.0  # s: 0.5 s to settle and 300 samples
RAMP = 0.05  # s, from level to level

# fine below 2 V, where the edges open; the flow meter sees nothing up to about 1 V
VALVE_STEPS = (*np.arange(0.25, 2.01, 0.25), *np.arange(2.5, 10.01, 0.5))
# 25 flows, nearly evenly from 15 to 281 L/min
HOSE_STEPS = tuple(np.round(np.linspace(1.25, 10.0, 25), 3))
HOSE_THROTTLE = 1.05e11  # C_R [Pa.s2/m6]: 281 L/min at 10 V

# four groups: throttle C_R [Pa.s2/m6], levels of the command [V], hold and ramp [s]. Small throttles give
# fast flow, for the inertance; large ones fast pressure, for the capacitance. What goes up comes down again,
# so that errors of the 200 Hz clock at the corners cancel. Flows stay above the meters' dead zone.
GROUPS: tuple[tuple[float, Sequence[float], float, float], ...] = (
    (6e11, (3.0, 8.0) * 20, 0.5, 0.06),
    (1.5e12, (3.0, 6.0, 9.0, 6.0) * 10, 0.5, 0.06),
    (3e12, (2.5, 4.0, 10.0, 4.0) * 10, 0.5, 0.08),
    (6e12, (2.0, 6.0) * 20, 0.5, 0.08),
)

# locked motor: set pressures of the driven port [MPa] at a low and a medium pressure of the other one
MOTOR_STEPS = tuple(range(2, 21, 2))
MOTOR_OTHER = (2.0, 8.0)
MOTOR_HOLD, MOTOR_RAMP = 3.0, 0.2  # s


def _meters(signals: Mapping[str, Array], flow: Instrument = FLOW) -> dict[str, Instrument]:
    """The instrument of each signal, by its name."""
    kinds = {"command": COMMAND, "pressure": PRESSURE}
    return {name: kinds.get(name.split("_")[0], flow) for name in signals}


def _edge(edge: str, machine: str) -> Experiment:
    time, steps = levels(up_and_down(VALVE_STEPS), HOLD, RAMP)
    command = EDGES[edge] * steps
    signals = {"command": command, **valve(machine, edge, time, command)}
    return Experiment(
        name=f"valve_{edge.replace('-', '').lower()}",
        title=f"Valve edge {edge}, stepped command",
        procedure="valve",
        use="train",
        machine=machine,
        conditions={"edge": edge},
        time=time,
        signals=signals,
        instruments=_meters(signals),
    )


def _hose(
    machine: str, name: str, title: str, procedure: str, signals: dict[str, Array], time: Array
) -> Experiment:
    p = detailed()
    conditions: dict[str, Condition] = {
        "length": (p.stick_hose_length, "m"),
        "diameter": (p.stick_hose_bore, "m"),
        "density": (p.density, "kg/m3"),
        "viscosity": (p.viscosity, "Pa.s"),
    }
    return Experiment(name, title, procedure, "train", machine, conditions, time, signals, _meters(signals))


def _hose_resistance(machine: str) -> Experiment:
    time, command = levels((0.0, *HOSE_STEPS), HOLD, RAMP)
    found = stick_hose(machine, HOSE_THROTTLE, time, command)
    signals = {n: found[n] for n in ("pressure_in", "pressure_out")} | {"flow": found["flow_out"]}
    title = "Hose of 4 m and 3/4 in, stepped flow"
    return _hose(machine, "hose_resistance", title, "hose_resistance", signals, time)


def _hose_dynamics(number: int, machine: str) -> Experiment:
    resistance, steps, hold, ramp = GROUPS[number - 1]
    time, command = levels((0.0, *steps), hold, ramp)
    signals = {"command": command, **stick_hose(machine, resistance, time, command)}
    title = f"Hose of 4 m and 3/4 in, fast changes, group {number}"
    return _hose(machine, f"hose_dynamics_{number}", title, "hose_dynamics", signals, time)


def _motor(driven: str, machine: str) -> Experiment:
    low, medium = MOTOR_OTHER
    steps = [2.0, *MOTOR_STEPS, *reversed(MOTOR_STEPS)]
    others = [low, *(low for _ in MOTOR_STEPS), *(medium for _ in MOTOR_STEPS)]
    time, this = levels(steps, MOTOR_HOLD, MOTOR_RAMP)
    _, other = levels(others, MOTOR_HOLD, MOTOR_RAMP)
    sides = (1e6 * this, 1e6 * other) if driven == "A" else (1e6 * other, 1e6 * this)
    signals = locked_motor(machine, time, *sides)
    return Experiment(
        name=f"motor_leakage_{1 if driven == 'A' else 2}",
        title=f"Swing motor, shaft locked, pressure at port {driven} stepped",
        procedure="motor_leakage",
        use="train",
        machine=machine,
        conditions={"shaft": "locked"},
        time=time,
        signals=signals,
        instruments=_meters(signals, LEAKAGE),
    )


PLANS: Mapping[str, Callable[[str], Experiment]] = {
    **{f"valve_{edge.replace('-', '').lower()}": partial(_edge, edge) for edge in EDGES},
    "hose_resistance": _hose_resistance,
    **{f"hose_dynamics_{n}": partial(_hose_dynamics, n) for n in range(1, len(GROUPS) + 1)},
    **{f"motor_leakage_{n}": partial(_motor, port) for n, port in enumerate("AB", 1)},
}
