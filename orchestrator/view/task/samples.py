"""What a training task reads of a run: by the names that the parts give their variables, in any component.

tip in space         tip_x, tip_y, tip_height [m]                            needed
speed of functions   swing_speed, boom_speed, stick_speed [rad/s]            needed
speed of the tip     |(tip_radial_velocity, tip_vertical_velocity, swing_speed r)| [m/s],
                     r^2 = x^2 + y^2                                         needed
supply               supply_pressure [Pa], supply_flow [m3/s]: of the component `supply` if there is one,
                     else the flows of all components together
pressures            of the six lines [Pa]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace

Array = NDArray[np.float64]

TIP = ("tip_x", "tip_y", "tip_height")
SPEEDS = ("swing_speed", "boom_speed", "stick_speed")
VELOCITIES = ("tip_radial_velocity", "tip_vertical_velocity")
PRESSURE, FLOW = "supply_pressure", "supply_flow"
LINES = (
    "swing_pressure_a",
    "swing_pressure_b",
    *(f"{axis}_{side}_pressure" for axis in ("boom", "stick") for side in ("head", "rod")),
)
NEEDED = (*TIP, *SPEEDS, *VELOCITIES)
WANTED = (*NEEDED, PRESSURE, FLOW, *LINES)
UNITS = {
    **dict.fromkeys(TIP, "m"),
    **dict.fromkeys(SPEEDS, "rad/s"),
    **dict.fromkeys(VELOCITIES, "m/s"),
    **dict.fromkeys((PRESSURE, *LINES), "Pa"),
    FLOW: "m3/s",
}


@dataclass(frozen=True)
class Samples:
    """A stretch of a run.

    time       (n,) [s]
    tip        (n, 3) [m]: forward, left, up
    speed      (n,) of the tip [m/s]
    functions  (n, 3) speeds of swing, boom and stick [rad/s]
    power      (n,) hydraulic power from the supply [W]; empty if the run does not hold it
    pressure   (n,) the largest of the lines [Pa]; empty if the run holds none
    """

    time: Array
    tip: Array
    speed: Array
    functions: Array
    power: Array
    pressure: Array

    def __getitem__(self, part: slice) -> Samples:
        return Samples(*(getattr(self, name)[part] for name in self.__dataclass_fields__))


def wanted(signals: Sequence[str]) -> tuple[str, ...]:
    """Those of the signals that a task reads."""
    return tuple(name for name in signals if _tail(name) in WANTED)


def of_trace(trace: Trace) -> Samples:
    """All samples of a run."""
    names = wanted(list(trace.signals))
    for name in names:
        unit = trace.units.get(name, UNITS[_tail(name)])
        if unit != UNITS[_tail(name)]:
            raise Problem(f"task: {name}: expected {UNITS[_tail(name)]}, found {unit}")
    return of_values(trace.time, {name: trace[name] for name in names})


def of_values(time: Array, values: Mapping[str, Array]) -> Samples:
    """Samples from the values of some signals, by name."""
    first = {_tail(name): name for name in reversed(list(values))}
    lacking = [tail for tail in NEEDED if tail not in first]
    if lacking:
        expected = ", ".join(NEEDED)
        raise Problem(f"task: expected a run with {expected}, found none of {', '.join(lacking)}")
    found = {tail: np.asarray(values[name], float) for tail, name in first.items()}
    tip = np.stack([found[name] for name in TIP], axis=1)
    lines = [found[name] for name in LINES if name in found]
    return Samples(
        time=np.asarray(time, float),
        tip=tip,
        speed=_speed(tip, found),
        functions=np.stack([found[name] for name in SPEEDS], axis=1),
        power=_power(values, found),
        pressure=np.max(lines, axis=0) if lines else np.empty(0),
    )


def _speed(tip: Array, found: Mapping[str, Array]) -> Array:
    across = found["swing_speed"] * np.hypot(tip[:, 0], tip[:, 1])
    speed: Array = np.linalg.norm([*(found[name] for name in VELOCITIES), across], axis=0)
    return speed


def _power(values: Mapping[str, Array], found: Mapping[str, Array]) -> Array:
    flows = [name for name in values if _tail(name) == FLOW]
    # a supply of its own already adds up what the drives take
    total = [name for name in flows if name.split(".")[-2:-1] == ["supply"]] or flows
    if not total or PRESSURE not in found:
        return np.empty(0)
    flow: Array = np.sum([values[name] for name in total], axis=0)
    return found[PRESSURE] * flow


def _tail(name: str) -> str:
    return name.rpartition(".")[2]
