"""What docs/fidelity.md runs: sets of variants and parameters, and the tests that each goes through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fmus.operator_input.work_cycle import WORK_CYCLE, WORK_CYCLE_STOP, Move, program
from orchestrator import run

SPEEDS = tuple(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick"))
PRESSURES = (
    *(f"boom_stick.{axis}_{side}_pressure" for axis in ("boom", "stick") for side in ("head", "rod")),
    *(f"swing.swing_pressure_{line}" for line in "ab"),
)
STICK = tuple(m for m in WORK_CYCLE if m.axis == "stick" and m.hold > 1)
SWING = tuple(m for m in WORK_CYCLE if m.axis == "swing")
Trace = dict[str, np.ndarray]


@dataclass(frozen=True)
class Case:
    """Variants {part: name} and parameters, beside the paper's set."""

    name: str
    swap: Mapping[str, str] = field(default_factory=dict)
    set: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Test:
    """One stroke from rest in a pose, a run for each ramp [s].

    A ramp as long as a period of an oscillation does not excite it: one ramp alone would say little.
    after   what is simulated after the lever is held [s], in ramps
    """

    pose: str
    stroke: Move
    ramps: tuple[float, ...]
    fall: float = 0.0
    after: float = 0.0

    def moves(self) -> tuple[Move, ...]:
        """The strokes."""
        return tuple(replace(self.stroke, rise=r, fall=self.fall * r) for r in self.ramps)

    def stop(self, move: Move) -> float:
        """When the run of a stroke ends [s]."""
        return round(move.start + move.rise + move.hold + move.fall + self.after, 3)


RAMPS = (0.2, 0.3, 0.4, 0.5, 0.6)
OUT = Test("nominal", Move("stick", 1.0, -3.4, 0.0, 3.0, 0.0), RAMPS)
IN = Test("nominal", Move("stick", 1.0, 3.4, 0.0, 2.2, 0.0), RAMPS)
# an operator lets a swing run out: the lever goes back three times as slowly
TURN = Test("reach", Move("swing", 1.0, 3.6, 0.0, 2.0, 0.0), (0.3, 0.4, 0.5, 0.6, 0.7), 3.0, 1.0)
QUICK = Test("reach", Move("swing", 1.0, 3.6, 0.0, 2.0, 0.0), (0.3,), 1.0, 1.0)

PAPER = Case("the paper's set")
FULL = {"boom_stick": "detailed", "swing": "detailed", "supply": "engine_pump"}
EFFECTS = (
    PAPER,
    Case("`boom_stick` detailed", {"boom_stick": "detailed"}),
    Case("`swing` detailed", {"swing": "detailed"}),
    Case("pendulum", {"manipulator": "pendulum"}),
    Case("friction", {"manipulator": "friction"}),
    Case("engine_pump", {"supply": "engine_pump"}),
    Case("detailed, pendulum, engine_pump", {**FULL, "manipulator": "pendulum"}),
    Case("the same with friction", {**FULL, "manipulator": "pendulum_friction"}),
)

# what makes detailed drives behave as lumped ones
IDEAL: Mapping[str, Mapping[str, float]] = {
    "spool": {"spool_frequency": 300.0, "spool_damping": 1.0, "spool_speed": 1000.0},
    "wall": {"hose_wall_modulus": 1e13},
    "air": {"air_share": 0.0},
    "valves": {"relief_pressure": 1e9, "anti_cavitation_area": 0.0},
}
WORDS = {
    "spool": "a spool of 8 Hz",
    "wall": "hose walls that give",
    "air": "0.5 % of air",
    "valves": "relief and anti-cavitation valves",
}


def ideal(part: str, *but: str) -> dict[str, float]:
    """Parameters of a detailed part without what makes it detailed, `but` for some of it."""
    return {f"{part}.{n}": v for of, found in IDEAL.items() if of not in but for n, v in found.items()}


def within(part: str) -> tuple[Case, ...]:
    """The detailed drives made ideal, then with one property after the other."""
    swap = {part: "detailed"}
    one = tuple(Case(f"+ {words}", swap, ideal(part, of)) for of, words in WORDS.items())
    return (
        Case("fast spool, stiff walls, no air, no valves", swap, ideal(part)),
        *one,
        Case("all of it", swap),
    )


EARLY = {f"boom_stick.spool_overlap_{edge}": 0.0 for edge in ("at", "bt")}
LINES = within("boom_stick")
CAUSES = (
    PAPER,
    Case("boom and stick quasistatic", {"boom_stick": "quasistatic"}),
    Case("stick with equal areas (rod of 10 mm)", set={"boom_stick.stick_rod": 0.01}),
    Case("stick and boom with equal areas", set={"boom_stick.stick_rod": 0.01, "boom_stick.boom_rod": 0.01}),
    Case("uneven spool: no overlap to tank (`detailed`)", {"boom_stick": "detailed"}, EARLY),
    Case("boom's piston damped five times as much", set={"manipulator.boom_piston_damping": 1e5}),
    Case("boom held", set={"manipulator.boom_piston_damping": 1e8}),
)
PENDULUM = {"manipulator": "pendulum"}
SPOOLS = {"boom_stick": "detailed", "swing": "detailed"}
SENSITIVITY = (
    Case("pendulum, damping ratio 0.02", PENDULUM, {"manipulator.head_joint_damping": 48.0}),
    Case("pendulum, damping ratio 0.1", PENDULUM),
    Case("pendulum, damping ratio 0.3", PENDULUM, {"manipulator.head_joint_damping": 720.0}),
    Case("pendulum, head of 250 kg", PENDULUM, {"manipulator.head_mass": 250.0}),
    Case("pendulum, head of 500 kg", PENDULUM, {"manipulator.head_mass": 500.0}),
    Case("point mass of 250 kg", set={"manipulator.head_mass": 250.0}),
    Case("point mass of 500 kg", set={"manipulator.head_mass": 500.0}),
    *(
        Case(f"both `detailed`, spools of {f} Hz", SPOOLS, {f"{d}.spool_frequency": f for d in SPOOLS})
        for f in (10, 30, 50)
    ),
    *(
        Case(f"both `detailed`, {100 * a:g} % of air", SPOOLS, {f"{d}.air_share": a for d in SPOOLS})
        for a in (0.002, 0.02)
    ),
)


def simulate(system: Path, case: Case, moves: Sequence[Move], stop: float, pose: str = "nominal") -> Trace:
    """A run with these strokes of the operator."""
    strokes = {f"operator_input.{name}": value for name, value in program(moves).items()}
    given = {**strokes, **case.set}
    names = (*SPEEDS, *PRESSURES)
    result = run(system, swap=case.swap, set=given, parameters=[pose], stop=stop, record=names)
    return {"time": result.trace.time, **{name: result.trace[name] for name in names}}


def tested(system: Path, case: Case, test: Test) -> list[tuple[Trace, Move]]:
    """The runs of a test with their strokes."""
    return [(simulate(system, case, [m], test.stop(m), test.pose), m) for m in test.moves()]


def cycle(system: Path, case: Case) -> Trace:
    """The work cycle."""
    return simulate(system, case, WORK_CYCLE, WORK_CYCLE_STOP)
