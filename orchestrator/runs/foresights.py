"""A foresight as native/foresight.c uses it."""

from __future__ import annotations

import ctypes

import numpy as np

from orchestrator.coupling.foresight import Foresight, Telling
from orchestrator.runs import layout
from orchestrator.runs.programs import Programs

ARRAYS = "slopes k kc closed inverse f x w f0 x0 w0 q course felt push v rows"

STAGES = 7  # vectors that C works with


def foresight(programs: Programs, known: Foresight) -> layout.Foresight:
    """A foresight; Foreign where a component is no FMU that C can call."""
    joined, at = known.joined, programs.at
    tellings = (layout.Telling * max(len(known.tellings), 1))()
    for made, one in zip(tellings, known.tellings, strict=False):
        _fill(programs, made, one)
    place = {id(s): i for i, s in enumerate(known.network.signals)}
    signals = [place[id(row.signal)] if row.signal else -1 for row in known.rows]
    return layout.Foresight(
        rates=programs.program(known.rates),
        values=programs.program(known.values),
        tellings=tellings,
        telling_count=len(known.tellings),
        **{name: at(getattr(joined, name)) for name in ARRAYS.split()},
        stages=at(np.zeros((STAGES, joined.wide))),
        kinds=at(known.kinds),
        signals=at(np.array(signals, np.int32)),
        n=joined.n,
        m=joined.m,
        wide=joined.wide,
        broad=joined.broad,
        through=joined.through,
        leads=known.leads,
        lag=known.lag,
        age=known.age,
    )


def _fill(programs: Programs, made: layout.Telling, one: Telling) -> None:
    call, at = programs.derivative(one.call), programs.at
    made.derivative, made.component, made.fmi = call.address, call.component, call.fmi
    made.of, made.by, made.outputs, made.count = at(call.of), at(call.by), len(call.of), len(call.by)
    made.seed, made.into = at(call.seed), at(call.into)
    made.from_, made.to, made.factor = at(one.of), at(one.to), at(one.factor)
    made.entries = len(one.of)
    programs.judges[ctypes.addressof(made)] = call
