"""Calls and arrays of a run as C sees them: instructions and addresses."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling.bank import Link
from orchestrator.coupling.loop import Loop
from orchestrator.coupling.member import Member
from orchestrator.runs import layout
from orchestrator.slaves.access import Access, Derivative
from orchestrator.slaves.slave import Call

KINDS = {layout.Access: layout.ACCESS, layout.Link: layout.LINK, layout.Loop: layout.LOOP}
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

    def program(self, calls: Sequence[Call]) -> layout.Program:
        """Calls as instructions; Foreign where one is no access, link or loop of FMUs."""
        instructions = (layout.Instruction * max(len(calls), 1))()
        for instruction, call in zip(instructions, calls, strict=False):
            what = self._instruction(call)
            instruction.kind = KINDS[type(what)]
            self._alive.append(what)
            instruction.what = ctypes.addressof(what)
        self._alive.append(instructions)
        return layout.Program(len(calls), instructions)

    def derivative(self, call: Call) -> Derivative:
        """The same call, if C can make it."""
        if not isinstance(call, Derivative):
            raise Foreign(call)
        return call

    def _instruction(self, call: Call) -> layout.Link | layout.Access | layout.Loop:
        if isinstance(call, Link):
            return self._link(call)
        if isinstance(call, Access):
            return self._access(call)
        if isinstance(call, Loop):
            return self._loop(call)
        raise Foreign(call)

    def _access(self, call: Access) -> layout.Access:
        made = layout.Access(
            function=call.address,
            component=call.component,
            references=self.at(call.references),
            orders=None if call.orders is None else self.at(call.orders),
            own=self.at(call.own),
            values=self.at(call.values),
            count=len(call.names),
            fmi=call.fmi,
            type=[np.dtype(kind) for kind in layout.TYPES].index(call.own.dtype),
            bank=layout.REAL if call.values.dtype == np.float64 else layout.WHOLE,
            sets=call.sets,
        )
        self.judges[ctypes.addressof(made)] = call
        return made

    def _link(self, call: Link) -> layout.Link:
        return layout.Link(
            source=self.at(call.source),
            target=self.at(call.target),
            factor=None if call.plain else self.at(call.factor),
            offset=None if call.plain else self.at(call.offset),
            count=len(call.source),
            bank=layout.REAL if call.values.dtype == np.float64 else layout.WHOLE,
        )

    def _loop(self, loop: Loop) -> layout.Loop:
        members = (layout.Member * len(loop.members))()
        for made, member in zip(members, loop.members, strict=True):
            self._fill(made, member)
        found = layout.Loop(
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

    def _fill(self, made: layout.Member, member: Member) -> None:
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
