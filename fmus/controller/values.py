"""Parameter and start values of the controller, collected from the subsystems of its machine."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from fmus.contract import Subsystem, quantities, symbolic
from fmus.controller.gains import Gains
from fmus.controller.variables import AXES, CYLINDERS, GEOMETRY, MOTOR, VALVE, ControllerInputs
from fmus.parameters import Number, Tables, numbers, read, values

GAINS = tuple(quantities(Gains))
NOMINAL = ("supply_pressure", "boom_holding_force", "stick_holding_force")  # start values of boom_stick
PRESSURES = tuple(n for n, q in quantities(ControllerInputs).items() if q.unit == "Pa")
FILE = Path(__file__).with_name("parameters.toml")


def controller_tables(swing: Subsystem, boom_stick: Subsystem, manipulator: Subsystem) -> Tables:
    """Parameter and start values of the controller for a machine built from these subsystems."""
    of_boom_stick, of_swing, of_manipulator = numbers(boom_stick), numbers(swing), numbers(manipulator)
    gains, poses = read(FILE)["parameters"], of_manipulator["parameters"]
    parameters = {n: gains[n] for n in GAINS}
    parameters |= {n: _noted(of_manipulator["parameters"][n], "manipulator") for n in GEOMETRY}
    parameters |= {n: _noted(of_boom_stick["parameters"][n], "boom_stick") for n in CYLINDERS}
    parameters |= {f"swing_{n}": _noted(of_swing["parameters"][n], "swing") for n in VALVE}
    parameters |= {n: _noted(of_swing["parameters"][n], "swing") for n in MOTOR}
    parameters |= {f"nominal_{n}": _noted(of_boom_stick["start"][n], "boom_stick") for n in NOMINAL}
    start = {f"{axis}_angle": _noted(poses[f"initial_{axis}_angle"], "manipulator") for axis in AXES}
    start |= {
        n: _noted(of_boom_stick["start"][n], "boom_stick") for n in ("supply_pressure", "tank_pressure")
    }
    pressures = start_pressures(swing) | start_pressures(boom_stick)
    at_rest = "pressure at rest in the nominal pose"
    start |= {n: Number(value, "Pa", "derived", at_rest) for n, value in pressures.items()}
    return {"parameters": parameters, "start": start}


def start_pressures(sub: Subsystem, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
    """Initial pressures of a drive that are inputs of the controller, rounded to nine digits.

    inputs   values by name that replace start values of the drive's inputs
    """
    v = values(sub)
    u = {**v.u, **(inputs or {})}
    x = symbolic(sub).initial()(*(list(group.values()) for group in (v.x, u, v.p))).full()[:, 0]
    return {n: float(f"{a:.9g}") for n, a in zip(v.x, x, strict=True) if n in PRESSURES}


def _noted(number: Number, component: str) -> Number:
    """The same value, with the component in its note."""
    return replace(number, note=f"{number.note} (as in {component})")
