"""A foresight as native/foresight.c uses it."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from orchestrator.coupling.foresight import Foresight, Telling
from orchestrator.runs import layout
from orchestrator.runs.loops import Filler
from orchestrator.slaves.access import Derivative

ARRAYS = "slopes k kc closed inverse f x w f0 x0 w0 q course felt push v rows"

STAGES = 7  # vectors that C works with


@dataclass(frozen=True)
class Foreteller:
    """Fills the structures of a foresight."""

    filler: Filler

    def foresight(self, foresight: Foresight) -> layout.Foresight:
        """A foresight; TypeError where a component is no FMU that C can call."""
        joined, at = foresight.joined, self.filler.at
        tellings = (layout.Telling * max(len(foresight.tellings), 1))()
        for made, one in zip(tellings, foresight.tellings, strict=False):
            self._fill(made, one)
        place = {id(s): i for i, s in enumerate(foresight.network.signals)}
        signals = [place[id(row.signal)] if row.signal else -1 for row in foresight.rows]
        return layout.Foresight(
            rates=self.filler.program(foresight.rates),
            values=self.filler.program(foresight.values),
            tellings=tellings,
            telling_count=len(foresight.tellings),
            **{name: at(getattr(joined, name)) for name in ARRAYS.split()},
            stages=at(np.zeros((STAGES, joined.wide))),
            kinds=at(foresight.kinds),
            signals=at(np.array(signals, np.int32)),
            n=joined.n,
            m=joined.m,
            wide=joined.wide,
            broad=joined.broad,
            through=joined.through,
            leads=foresight.leads,
            lag=foresight.lag,
            age=foresight.age,
        )

    def _fill(self, made: layout.Telling, one: Telling) -> None:
        call, at = one.call, self.filler.at
        if not isinstance(call, Derivative):
            raise TypeError(f"{call!r} cannot be called from C")
        made.derivative, made.component, made.fmi = call.address, call.component, call.fmi
        made.of, made.by, made.outputs, made.count = at(call.of), at(call.by), len(call.of), len(call.by)
        made.seed, made.into = at(call.seed), at(call.into)
        made.from_, made.to, made.factor = at(one.of), at(one.to), at(one.factor)
        made.entries = len(one.of)
        self.filler.judges[ctypes.addressof(made)] = call
