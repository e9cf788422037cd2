"""The lumped machine moved joint by joint, integrated tightly, and what instruments make of it."""

from functools import lru_cache

import numpy as np
from identification.procedures.bench import recorded
from kit.equations import machine, played

from fmus.identification.procedures import momentum_balance
from fmus.identification.procedures.momentum_balance import ALL_PRESSURES, ANGLES, PARAMETERS
from fmus.machine.parts import FERIC
from fmus.operator_input.work_cycle import Move
from fmus.parameters import complete
from orchestrator.data.recording import Sensor

STEP = 0.005  # 200 Hz as the paper's
KNOWN = {f"{s.name}.{n}": v for s in FERIC.subsystems.values() for n, v in complete(s)["parameters"].items()}
P = momentum_balance.HARVESTER.vector(KNOWN)
V = {n.partition(".")[2]: x for n, x in zip(PARAMETERS, P, strict=True)}  # what two parts have is equal
ENCODER = Sensor("encoder of 65536 counts", 0.0, 2 * np.pi / 65536)
PRESSURE = Sensor("pressure transducer", 1e4, 4e7 / 4096, 0.0, 4e7)
UNITS = dict.fromkeys(ANGLES, "rad") | dict.fromkeys(ALL_PRESSURES, "Pa")
# lever strokes with ramps of 0.6 s: (start [s], hold [s], volts)
STROKES = {
    "swing": ((1.0, 1.8, 4.0), (5.0, 1.8, -5.0), (9.0, 1.3, 6.0), (12.5, 1.8, -5.0)),
    "boom": ((1.0, 1.3, 3.0), (4.5, 1.3, -3.0), (8.0, 0.3, 5.0), (10.5, 0.3, -4.5)),
    "stick": ((1.0, 1.3, 3.5), (4.5, 1.3, -3.5), (8.0, 0.3, 5.0), (10.5, 0.3, -5.0)),
}


def gravity(boom, stick, held=0.0):
    """Torques of gravity [N.m] about the boom's and the stick's pivot, by hand, with a mass at the tip."""
    along, outer = np.exp(1j * boom), np.exp(1j * (boom + stick))
    elbow, head = complex(V["stick_pivot_x"], V["stick_pivot_z"]) * along, V["head_mass"] + held
    own = V["stick_mass"] * complex(V["stick_centre_x"], V["stick_centre_z"]) * outer
    own += head * V["stick_length"] * outer
    inner = V["boom_mass"] * complex(V["boom_centre_x"], V["boom_centre_z"]) * along
    inner += (V["stick_mass"] + head) * elbow
    return V["gravity"] * (inner + own).real, V["gravity"] * own.real


@lru_cache
def motion_of(*joints, length=16.0):
    """Signals by name, without noise, while these joints are moved."""
    time = np.arange(round(length / STEP) + 1) * STEP
    levers = {
        f"{j}_command": sum(Move(j, start, v, 0.6, hold, 0.6).sample(time) for start, hold, v in STROKES[j])
        for j in joints
    }
    found = played(machine(), time, levers, tolerance=1e-8)
    return time, {n: found[n] for n in (*ANGLES, *ALL_PRESSURES)}


def recording(*joints, seed=None, encoder=ENCODER, pressure=PRESSURE, length=16.0):
    """A recording of the machine; without a seed the instruments are perfect."""
    time, signals = motion_of(*joints, length=length)
    sensors = {} if seed is None else {n: encoder if n in ANGLES else pressure for n in signals}
    procedure = "damping" if len(joints) == 1 else "machine"
    conditions = {"joint": joints[0]}
    return recorded(f"damping_{joints[0]}", time, signals, UNITS, sensors, seed, procedure, conditions)
