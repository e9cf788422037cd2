"""Structure of the machine: subsystems, their variants, and their connections."""

from collections.abc import Iterable, Mapping
from itertools import permutations
from typing import TypeAlias

from fmus import boom_stick, manipulator, supply, swing
from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.manipulator import MANIPULATOR
from fmus.operator_input.model import OPERATOR
from fmus.supply import SUPPLY
from fmus.swing import SWING
from orchestrator.base.errors import Problem


class Parts(dict[str, Mapping[str, Subsystem]]):
    """Variants of each part by name, the default one first."""

    def __repr__(self) -> str:
        return "\n".join(f"{part}: {', '.join(variants)}" for part, variants in self.items())


FAMILIES: Mapping[str, Mapping[str, Subsystem]] = Parts(
    swing=swing.VARIANTS,
    boom_stick=boom_stick.VARIANTS,
    manipulator=manipulator.VARIANTS,
    supply=supply.VARIANTS,
)
# variants with another circuit than the paper's machine: differences from the others are no errors
OTHER_CIRCUITS = ("compensated", "load_sensing")
# the machines of studies and of the virtual rig, as variants of their parts
MACHINES: Mapping[str, Mapping[str, str]] = {
    "lumped": {},
    "detailed": {
        "swing": "detailed",
        "boom_stick": "detailed",
        "manipulator": "pendulum_friction",
        "supply": "engine_pump",
    },
}
# default variants: of the machine, and of the machine with supply and operator
SUBSYSTEMS: Mapping[str, Subsystem] = {s.name: s for s in (SWING, BOOM_STICK, MANIPULATOR)}
ALL: Mapping[str, Subsystem] = {**SUBSYSTEMS, SUPPLY.name: SUPPLY, OPERATOR.name: OPERATOR}
Connections: TypeAlias = tuple[tuple[str, str], ...]
Inputs: TypeAlias = Mapping[str, tuple[str, ...]]  # external input -> component inputs that it feeds


def plugged(chosen: Iterable[Subsystem]) -> Connections:
    """Connections of the terminals that fit, in which each output feeds the input of the same member.

    Terminals fit if they have one name. Those of the supply end with the name of the part behind them:
    `supply_line_swing` fits `supply_line` of swing.
    """
    wires = []
    for source, target in permutations(chosen, 2):
        outputs, inputs = quantities(source.outputs), quantities(target.inputs)
        sockets = {t.name: {m.name: m.variable for m in t.members} for t in target.terminals}
        for plug in source.terminals:
            names = (
                plug.name,
                f"{plug.name}_{source.component}",
                plug.name.removesuffix(f"_{target.component}"),
            )
            for socket in (sockets[name] for name in dict.fromkeys(names) if name in sockets):
                pairs = ((m.variable, socket[m.name]) for m in plug.members)
                fitting = ((out, into) for out, into in pairs if out in outputs and into in inputs)
                wires += [
                    (f"{source.component}.{out}", f"{target.component}.{into}") for out, into in fitting
                ]
    return tuple(wires)


def wiring(chosen: Mapping[str, Subsystem]) -> tuple[Connections, Inputs]:
    """Connections and external inputs of a machine of these parts, with or without supply.

    Parts that have an input of one name share it. The inputs of one drive come first, then those of several.
    """
    connections, inputs = plugged(chosen.values()), dict[str, tuple[str, ...]]()
    fed = {target for _, target in connections}
    for part, sub in chosen.items():
        for name in quantities(sub.inputs):
            if (end := f"{part}.{name}") not in fed:
                inputs[name] = (*inputs.get(name, ()), end)
    ends = sorted(inputs.values(), key=lambda e: (not e[0].startswith(DRIVES), len(e) > 1))
    return connections, {e[0].partition(".")[2]: e for e in ends}


def _added(part: Subsystem) -> Connections:
    """The connections of one more part with the machine."""
    return tuple(wire for wire in plugged((*SUBSYSTEMS.values(), part)) if wire not in CONNECTIONS)


DRIVES = ("swing", "boom_stick")
JOINT_SPEEDS = tuple(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick"))
CONNECTIONS, INPUTS = wiring(SUBSYSTEMS)
RATE_OF = {
    n: q.rate for sub in (*SUBSYSTEMS.values(), SUPPLY) for n, q in quantities(sub.inputs).items() if q.rate
}
# rate ports: exact time derivatives of other connected signals, optional; a velocity has one itself
RATES: Connections = tuple(
    (source, target)
    for source, target in CONNECTIONS
    if target.partition(".")[2] in {*RATE_OF.values()} - {*RATE_OF}
)
# only for initialisation: holding forces of the pose, from which the initial pressures follow
HOLDING: Connections = tuple(wire for wire in CONNECTIONS if wire[0].endswith("_holding_force"))
COMMAND_WIRES, SUPPLY_WIRES = _added(OPERATOR), _added(SUPPLY)
# the controller replaces the operator, and measures what it has an input for
CONTROL_WIRES: Connections = (
    *_added(CONTROLLER),
    *(
        (f"{sub.name}.{name}", f"{CONTROLLER.name}.{name}")
        for name in quantities(CONTROLLER.inputs)
        for sub in (*SUBSYSTEMS.values(), SUPPLY)
        if name in quantities(sub.outputs)
    ),
)

# parameter -> parts that it describes together: the cylinders press on oil and on the linkage
SHARED: Mapping[str, tuple[str, ...]] = dict.fromkeys(
    ("boom_stroke", "stick_stroke"), ("boom_stick", "manipulator")
)


def parts(**variants: str) -> dict[str, Subsystem]:
    """Parts of the machine by name, in their default variants except for the variants in the arguments.

    Example: parts(boom_stick="detailed", supply="engine_pump"). The supply is included only if it is an
    argument.
    """
    for part, variant in variants.items():
        family = FAMILIES.get(part)
        if family is None or variant not in family:
            expected = (
                f"a variant of {part}: {', '.join(family)}" if family else f"a part: {', '.join(FAMILIES)}"
            )
            raise Problem(f"{part}={variant}: expected {expected}")
    return {**SUBSYSTEMS} | {part: FAMILIES[part][variant] for part, variant in variants.items()}
