"""What to say about inputs and loops through which nothing moves at the operating point."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orchestrator.linear.member import Array
from orchestrator.linear.plant import Plant
from orchestrator.system.system import Port

WHY = "a command in its dead band or beyond its range, a controller that is off"


def silent(plant: Plant, b: Array) -> tuple[str, ...]:
    """Notes. b: of the inputs of the linear model, the first ones of the plant."""
    if not len(b):
        return ()
    inlets = plant.choice.inputs[: b.shape[1]]
    none = [inlet.name for inlet, column in zip(inlets, b.T, strict=True) if not column.any()]
    cut = [str(port) for port in _cut(plant)]
    notes = (f"no state depends here on {', '.join(none)} ({WHY})",) if none else ()
    return (*notes, f"loops are open here at {', '.join(cut)} ({WHY})") if cut else notes


def _cut(plant: Plant) -> Iterator[Port]:
    """Outputs that go nowhere here, of components that stand between the inputs and the rest.

    Such an output is wired to an input on which a state may depend, and no state depends on any input that
    it is wired to. What has no inputs from outside, such as the machine behind a controller, is left out:
    that no pressure depends on a position where nothing flows opens no loop.
    """
    own = plant.blocks()
    moved = np.asarray((own.b @ plant.closed(own.d)).any(axis=0))
    between = {port.component for inlet in plant.choice.inputs for port, _ in inlet.targets}
    for j, output in enumerate(plant.outputs):
        fed = [i for i, row in enumerate(plant.wires) if row[j]]
        able = any(_able(plant, plant.inputs[i]) for i in fed)
        if output.component in between and able and not moved[fed].any():
            yield output


def _able(plant: Plant, port: Port) -> bool:
    """May a state of the component depend on this input, as far as its model description tells?"""
    face = plant.system.components[port.component].interface
    told = [face.knowns.get(rate) for rate in face.states.values()]
    return any(known is None or port.variable in known for known in told)
