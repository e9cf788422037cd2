"""The structures of native/run.h, filled from a run; `Programs` gives addresses and instructions.

What changes in a run is copied here as it is at the start, arrays apart, which both sides share.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from orchestrator.coupling import signal
from orchestrator.coupling.driver import Driver
from orchestrator.coupling.network import Network
from orchestrator.coupling.pace import Pace
from orchestrator.coupling.part import Part
from orchestrator.runs import layout
from orchestrator.runs.energy import ROWS, Monitor
from orchestrator.runs.programs import Foreign, Programs
from orchestrator.runs.recorder import BLOCK, Recorder
from orchestrator.slaves.access import Stepping

DRIVEN = (  # what a driver keeps in arrays
    *("columns", "targets", "factor", "offset"),
    *("steady_columns", "steady", "steady_factor", "steady_offset", "held_columns", "held"),
)


def stepping(part: Part) -> Stepping:
    """What it takes to step a component from C; Foreign if it is no FMU, or not stepped as FMUs are."""
    found = getattr(part.slave, "stepping", None)
    if found is None:
        raise Foreign(part.slave.name)
    return found(part.kept)  # type: ignore[no-any-return]


def fill_network(run: layout.Run, programs: Programs, network: Network) -> None:
    """The values, their exchange, and what sets them."""
    at, kept = programs.at, (network.real.values.copy(), network.whole.values.copy())
    run.real, run.whole = at(network.real.values), at(network.whole.values)
    run.real_kept, run.whole_kept = at(kept[0]), at(kept[1])
    run.used, run.slopes = at(network.used), at(network.slopes)
    run.reals, run.wholes = len(kept[0]), len(kept[1])
    run.exchange = programs.program(network.exchange_calls)
    place = {id(s): i for i, s in enumerate(network.signals)}
    bonds = [[place[id(effort)], place[id(flow)]] for effort, flow in network.bonds]
    run.bonds, run.bond_count = at(np.array(bonds, np.int32).reshape(-1)), len(bonds)


def signals(known: Sequence[signal.Signal]) -> ctypes.Array[layout.Signal]:
    """The inputs that move."""
    made = (layout.Signal * max(len(known), 1))()
    for mine, one in zip(made, known, strict=False):
        for name in (field[0] for field in layout.Signal._fields_):
            value = getattr(one, name)
            setattr(mine, name, tuple(value) if name == "c" else value)
    return made


def part(programs: Programs, network: Network, k: int, step: Stepping, repeated: bool) -> layout.Part:
    """Component k; repeated: further passes compute it again."""
    known, at, program = network.parts[k], programs.at, programs.program
    results = dict(zip(("event", "terminate", "early", "last"), step.results, strict=False))
    return layout.Part(
        component=step.component,
        do_step=step.do_step,
        get_state=step.get_state,
        set_state=step.set_state,
        flags=step.flags,
        clock=at(step.clock),
        fmi=step.fmi,
        final=not known.kept,
        kept=known.kept,
        repeated=repeated,
        even=known.even,
        factor=known.factor,
        first=network.signals.index(known.signals[0]) if known.signals else 0,
        count=len(known.signals),
        revalued=len(known.values) > 0,
        rough=known.rough,
        values=at(known.values),
        derivatives=at(known.derivatives),
        writers=program(known.writers),
        reads=program(known.reads),
        newest=program(known.newest),
        tell=program([known.tell] if known.tell else []),
        **results,
    )


def driver(programs: Programs, network: Network, known: Driver) -> layout.Driver:
    """A scenario."""
    at, table = programs.at, known.table
    arrays = dict(zip(("time", "base", "slopes", "anchor"), (at(a) for a in table.arrays), strict=True))
    places = {s.target: i for i, s in enumerate(network.signals)}
    numbers = np.array([places[int(t)] for t in known.targets], np.int32)
    return layout.Driver(
        **arrays,
        samples=len(table.arrays[0]),
        width=table.arrays[1].shape[1],
        **{name: at(getattr(known, name)) for name in DRIVEN},
        coming=at(np.zeros(len(numbers))),
        middle=at(np.zeros(len(numbers))),
        signals=at(numbers),
        count=len(numbers),
        steady_count=len(known.steady),
        held_count=len(known.held),
        when=np.nan,
        writers=programs.program(known.writers),
    )


def monitor(programs: Programs, known: Monitor) -> layout.Monitor:
    """What watches the bonds."""
    at = programs.at
    return layout.Monitor(
        places=at(known.places),
        spread=at(known.spread),
        moved=at(known.moved.view(np.uint8)),
        seen=at(known.seen),
        step=at(known.step),
        first=at(known.first),
        last=at(known.last),
        truth=at(known.true),
        count=len(known.places),
        room=ROWS,
        readers=programs.program(known.readers),
    )


def recorder(programs: Programs, known: Recorder) -> layout.Recorder:
    """What records."""
    at, fresh = programs.at, known.fresh
    return layout.Recorder(
        places=None if known.places is None else at(known.places),
        whole_places=at(known.whole_places),
        time=at(fresh.time),
        reals=at(fresh.reals),
        wholes=at(fresh.wholes),
        count=fresh.reals.shape[1],
        whole_count=fresh.wholes.shape[1],
        room=BLOCK,
    )


def pace(known: Pace) -> layout.Pace:
    """What chooses the steps."""
    names = ("h", "smallest", "largest", "power", "repeats")
    return layout.Pace(**{name: getattr(known, name) for name in names})
