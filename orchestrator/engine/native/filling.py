"""Calls and arrays of a run as C sees them: instructions and addresses.

A foresight as native/foresight.c uses it.

The structures of native/run.h, filled from a run; `Programs` gives addresses and instructions.

What changes in a run is copied here as it is at the start, arrays apart, which both sides share.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.engine import input_signal
from orchestrator.engine.algebraic_loop import Member
from orchestrator.engine.communication_step import Pace
from orchestrator.engine.component import Part
from orchestrator.engine.linear_prediction import Foresight, Telling
from orchestrator.engine.native import structures
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import BLOCK, ROWS, Monitor, Recorder
from orchestrator.engine.scenario import Driver
from orchestrator.engine.wiring import Link, Loop
from orchestrator.fmi.calls import Access, Call, Derivative, Stepping

KINDS = {
    structures.Access: structures.ACCESS,
    structures.Link: structures.LINK,
    structures.Loop: structures.LOOP,
}
LOOP = "u y g residual step before start scale unit seen slopes matrix shares source factor offset rows"
LOOP += " flags counts"  # the arrays of a loop


class Foreign(TypeError):
    """Something that C cannot call."""

    def __init__(self, what: object) -> None:
        super().__init__(f"{what} cannot be called from C")


class Judge(Protocol):
    """Raises what there is to say about a status."""

    def judge(self, status: int, /) -> None: ...


class Programs:
    """Makes instructions of calls, and keeps alive what C has the addresses of.

    judges   address of a structure -> what judges the statuses that C has of it
    """

    def __init__(self) -> None:
        self.judges: dict[int, Judge] = {}
        self._alive: list[Any] = []

    def at(self, array: NDArray[Any]) -> int:
        """The address of an array that C uses."""
        if not array.flags.c_contiguous:
            raise ValueError("expected a contiguous array")
        self._alive.append(array)
        return array.ctypes.data

    def program(self, calls: Sequence[Call]) -> structures.Program:
        """Calls as instructions; Foreign where one is no access, link or loop of FMUs."""
        instructions = (structures.Instruction * max(len(calls), 1))()
        for instruction, call in zip(instructions, calls, strict=False):
            what = self._instruction(call)
            instruction.kind = KINDS[type(what)]
            self._alive.append(what)
            instruction.what = ctypes.addressof(what)
        self._alive.append(instructions)
        return structures.Program(len(calls), instructions)

    def derivative(self, call: Call) -> Derivative:
        """The same call, if C can make it."""
        if not isinstance(call, Derivative):
            raise Foreign(call)
        return call

    def _instruction(self, call: Call) -> structures.Link | structures.Access | structures.Loop:
        if isinstance(call, Link):
            return self._link(call)
        if isinstance(call, Access):
            return self._access(call)
        if isinstance(call, Loop):
            return self._loop(call)
        raise Foreign(call)

    def _access(self, call: Access) -> structures.Access:
        made = structures.Access(
            function=call.address,
            component=call.component,
            references=self.at(call.references),
            orders=None if call.orders is None else self.at(call.orders),
            own=self.at(call.own),
            values=self.at(call.values),
            count=len(call.names),
            fmi=call.fmi,
            type=[np.dtype(kind) for kind in structures.TYPES].index(call.own.dtype),
            bank=structures.REAL if call.values.dtype == np.float64 else structures.WHOLE,
            sets=call.sets,
        )
        self.judges[ctypes.addressof(made)] = call
        return made

    def _link(self, call: Link) -> structures.Link:
        return structures.Link(
            source=self.at(call.source),
            target=self.at(call.target),
            factor=None if call.plain else self.at(call.factor),
            offset=None if call.plain else self.at(call.offset),
            count=len(call.source),
            bank=structures.REAL if call.values.dtype == np.float64 else structures.WHOLE,
        )

    def _loop(self, loop: Loop) -> structures.Loop:
        members = (structures.Member * len(loop.members))()
        for made, member in zip(members, loop.members, strict=True):
            self._fill(made, member)
        found = structures.Loop(
            members=members,
            **{name: self.at(getattr(loop.newton, name)) for name in LOOP.split()},
            targets=self.at(loop.targets),
            sources=self.at(loop.sources),
            member_count=len(members),
            count=len(loop.inputs),
            outputs=len(loop.outputs),
            sweeps=loop.knot.sweeps,
        )
        self.judges[ctypes.addressof(found)] = loop
        return found

    def _fill(self, made: structures.Member, member: Member) -> None:
        made.writers, made.readers = self.program(member.writers), self.program(member.readers)
        made.first, made.count = member.inputs.first, len(member.inputs.names)
        made.first_output, made.outputs = member.outputs.first, len(member.outputs.names)
        made.seed, made.into = self.at(member.seed), self.at(member.into)
        made.trusted = self.at(member.trusted)
        if member.derivative is None:
            return
        told = self.derivative(member.derivative)
        made.derivative, made.component, made.fmi = told.address, told.component, told.fmi
        made.of, made.by = self.at(told.of), self.at(told.by)
        self.judges[ctypes.addressof(made)] = told


ARRAYS = "slopes k kc closed inverse f x w f0 x0 w0 q course felt push v rows"

STAGES = 7  # vectors that C works with


def foresight(programs: Programs, known: Foresight) -> structures.Foresight:
    """A foresight; Foreign where a component is no FMU that C can call."""
    joined, at = known.joined, programs.at
    tellings = (structures.Telling * max(len(known.tellings), 1))()
    for made, one in zip(tellings, known.tellings, strict=False):
        _fill(programs, made, one)
    place = {id(s): i for i, s in enumerate(known.network.signals)}
    signals = [place[id(row.signal)] if row.signal else -1 for row in known.rows]
    return structures.Foresight(
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


def _fill(programs: Programs, made: structures.Telling, one: Telling) -> None:
    call, at = programs.derivative(one.call), programs.at
    made.derivative, made.component, made.fmi = call.address, call.component, call.fmi
    made.of, made.by, made.outputs, made.count = at(call.of), at(call.by), len(call.of), len(call.by)
    made.seed, made.into = at(call.seed), at(call.into)
    made.from_, made.to, made.factor = at(one.of), at(one.to), at(one.factor)
    made.entries = len(one.of)
    programs.judges[ctypes.addressof(made)] = call


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


def fill_network(run: structures.Run, programs: Programs, network: Network) -> None:
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


def signals(known: Sequence[input_signal.Signal]) -> ctypes.Array[structures.Signal]:
    """The inputs that move."""
    made = (structures.Signal * max(len(known), 1))()
    for mine, one in zip(made, known, strict=False):
        for name in (field[0] for field in structures.Signal._fields_):
            value = getattr(one, name)
            setattr(mine, name, tuple(value) if name == "c" else value)
    return made


def part(programs: Programs, network: Network, k: int, step: Stepping, repeated: bool) -> structures.Part:
    """Component k; repeated: further passes compute it again."""
    known, at, program = network.parts[k], programs.at, programs.program
    results = dict(zip(("event", "terminate", "early", "last"), step.results, strict=False))
    return structures.Part(
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


def driver(programs: Programs, network: Network, known: Driver) -> structures.Driver:
    """A scenario."""
    at, table = programs.at, known.table
    arrays = dict(zip(("time", "base", "slopes", "anchor"), (at(a) for a in table.arrays), strict=True))
    places = {s.target: i for i, s in enumerate(network.signals)}
    numbers = np.array([places[int(t)] for t in known.targets], np.int32)
    return structures.Driver(
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


def monitor(programs: Programs, known: Monitor) -> structures.Monitor:
    """What watches the bonds."""
    at = programs.at
    return structures.Monitor(
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


def recorder(programs: Programs, known: Recorder) -> structures.Recorder:
    """What records."""
    at, fresh = programs.at, known.fresh
    return structures.Recorder(
        places=None if known.places is None else at(known.places),
        whole_places=at(known.whole_places),
        time=at(fresh.time),
        reals=at(fresh.reals),
        wholes=at(fresh.wholes),
        count=fresh.reals.shape[1],
        whole_count=fresh.wholes.shape[1],
        room=BLOCK,
    )


def pace(known: Pace) -> structures.Pace:
    """What chooses the steps."""
    names = ("h", "smallest", "largest", "power", "repeats")
    return structures.Pace(**{name: getattr(known, name) for name in names})
