"""The machines of a comparison with what the user sets, and where one is not what its controller assumes."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.errors import Problem
from orchestrator.system.interface import Value
from orchestrator.system.system import System

CONTROLLER = "controller"
ALONE = "--swap swing=lumped"
CLOSE = 1e-9  # relative: more digits than anybody writes


def assembled(
    system: System, machines: Mapping[str, Mapping[str, str]], given: Mapping[str, Value | str]
) -> dict[str, System]:
    """Every machine {name: swaps} with its start values; a name that only others have is told as such."""
    swapped = {name: system.swapped(swap) for name, swap in machines.items()}
    for value in given:
        having = [name for name, machine in swapped.items() if machine.has(value)]
        lacking = [name for name in swapped if name not in having]
        if having and lacking:
            part = value.partition(".")[0]
            swaps = [f"--swap {part}={variant}" for n in having if (variant := machines[n].get(part))]
            raise Problem(
                f"--set {value}: the {' and '.join(lacking)} machine has no such variable, only the"
                f" {' and '.join(having)} one; to run one machine alone: {[*swaps, ALONE][0]}, for example"
            )
    return {name: machine.with_start(given) for name, machine in swapped.items()}


def differences(system: System) -> list[str]:
    """One note for each number that the controller has as well, in the same unit, but with another value.

    The controller names a number as its part does, or `part_name` where parts have one of the same name.
    """
    if CONTROLLER not in system.components:
        return []
    controller = system.components[CONTROLLER]
    own, found = controller.numbers(), []
    for part, component in system.components.items():
        for name, value in {} if part == CONTROLLER else component.numbers().items():
            known = f"{part}_{name}" if f"{part}_{name}" in own else name
            if known not in own or abs(own[known] - value) <= CLOSE * max(abs(own[known]), abs(value)):
                continue
            unit = component.interface.variables[name].unit
            if controller.interface.variables[known].unit == unit:
                here = f" {unit.name}" if unit and unit.name != "1" else ""
                found.append(
                    f"{CONTROLLER}.{known} is {own[known]:.6g}{here}, {part}.{name} {value:.6g}{here}:"
                    " the controller believes another machine"
                )
    return found
