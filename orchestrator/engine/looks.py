"""`Looks`: what outputs do inside of steps, where an estimate of errors does not see it; see native/looks.c."""

from __future__ import annotations

from typing import Any

import numpy as np

from orchestrator.base.text import grouped
from orchestrator.engine.c_library import Binding
from orchestrator.engine.network import Network
from orchestrator.engine.result import Unseen
from orchestrator.fmi.calls import calls_by_type
from orchestrator.ssp.dependencies import untold_outputs

LEAST_JUMP = 0.01  # over the range of an output
LEAST_HIDDEN = 1e-3  # a pulse in a thousand steps


class Looks:
    """Looks at the outputs of a network that are known at communication points only.

    components   that are looked at: name -> their outputs
    """

    def __init__(self, network: Network, looked: bool) -> None:
        """looked: False for runs with events or a master of one's own, whose steps end anywhere."""
        self._network = network
        self.components = grouped(untold_outputs(network.system), lambda p: p.component) if looked else {}
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
            looks.goes_back = slave.interface.rollback and slave.interface.variable_step
            structs.append(looks)
        self._structs = binding.array(h.Looks, structs)
        binding.simulation.looks, binding.simulation.look_count = binding.pointer(self._structs), len(structs)

    def found(self) -> dict[str, Unseen]:
        """The outputs that hide something or jump."""
        seen = {}
        for looks, (name, ports) in zip(self._structs, self.components.items(), strict=False):
            for port, at in zip(ports, self._at[name], strict=False):
                span = at.highest - at.lowest
                hidden, jumps = at.hidden / max(looks.count, 1), at.jump > LEAST_JUMP * span
                hidden *= hidden > LEAST_HIDDEN * span
                if hidden or jumps:
                    seen[str(port)] = Unseen(hidden / span, jumps)
        return seen
