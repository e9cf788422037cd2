"""`Looks`: what outputs do inside of steps, where no estimate of errors sees it; see native/looks.c."""

from __future__ import annotations

from typing import Any

import numpy as np

from orchestrator.base.text import first_names, grouped
from orchestrator.engine.c_library import Binding
from orchestrator.engine.network import Network
from orchestrator.engine.result import FLOOR, LEAST_RANGE, Unseen
from orchestrator.fmi.calls import Slave, calls_by_type
from orchestrator.fmi.interface import MODEL_EXCHANGE
from orchestrator.ssp.dependencies import untold_outputs

LEAST_JUMP = 0.01  # over the range of an output
LEAST_HIDDEN = 1e-3  # a pulse in a thousand steps


class Looks:
    """Looks at the outputs of a network that are known at communication points only.

    components   that are looked at: name -> their outputs
    go_back      those that can step to a time inside a step, and back
    """

    def __init__(self, network: Network, looked: bool) -> None:
        """looked: False for runs with events or a master of one's own, whose steps end anywhere."""
        self._network = network
        self.components = grouped(untold_outputs(network.system), lambda p: p.component) if looked else {}
        self.go_back = {name for name in self.components if _goes_back(network.slaves[name])}
        self._structs: Any = ()
        self._at: dict[str, Any] = {}

    def fill(self, binding: Binding) -> None:
        """Fill the C structures."""
        h, names, reals = binding.h, [*self._network.slaves], self._network.reals.index
        structs = []
        for name, ports in self.components.items():
            slave, inside = self._network.slaves[name], np.zeros(len(ports))
            self._at[name] = at = binding.array(
                h.LookedAt, [h.LookedAt(index=reals[p], lowest=np.inf, highest=-np.inf) for p in ports]
            )
            reads = calls_by_type(slave, [p.variable for p in ports], inside, slave.reader)
            looks = h.Looks(reads=binding.program(reads), inside=binding.at(inside), at=binding.pointer(at))
            looks.component, looks.outputs = names.index(name), len(ports)
            looks.goes_back = name in self.go_back
            structs.append(looks)
        self._structs = binding.array(h.Looks, structs)
        binding.simulation.looks, binding.simulation.look_count = binding.pointer(self._structs), len(structs)

    @property
    def notes(self) -> tuple[str, ...]:
        """A remark on outputs that nobody could look at."""
        pairs = zip(self._structs, self.components.values(), strict=False)
        never = (ports for looks, ports in pairs if not (looks.goes_back or looks.count))
        blind = first_names(str(p) for ports in never for p in ports)
        reason = "because the FMUs cannot step to a time there and back"
        return (f"not looked at inside of steps, {reason}: {blind}",) if blind else ()

    def found(self, elapsed: float) -> dict[str, Unseen]:
        """The outputs that hide something or jump; elapsed: simulated time [s]."""
        seen = {}
        for looks, (name, ports) in zip(self._structs, self.components.items(), strict=False):
            for port, at in zip(ports, self._at[name], strict=False):
                least = LEAST_RANGE * abs(self._network.system.variable(port).nominal or 0.0)
                span, hidden = max(at.highest - at.lowest, least, FLOOR), at.hidden / max(looks.count, 1)
                hidden *= hidden > LEAST_HIDDEN * span
                if hidden or at.jump > LEAST_JUMP * span:
                    seen[str(port)] = Unseen(hidden / span, at.late / (elapsed * span))
        return seen


def _goes_back(slave: Slave) -> bool:
    """Can a component step to any time and back? Its binary may lack the functions that it declares."""
    face, fmu = slave.interface, getattr(slave, "fmu", None)
    lacks = fmu and face.kind != MODEL_EXCHANGE and not fmu.library.has(fmu.name("GetFMUState"))
    return face.rollback and face.variable_step and not lacks
