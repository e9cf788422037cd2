"""Algebraic loops as native/loop.c solves them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from orchestrator.coupling.loop import Loop
from orchestrator.coupling.member import Member
from orchestrator.runs import layout
from orchestrator.slaves.access import Derivative
from orchestrator.slaves.slave import Call

ARRAYS = "u y g residual step before start scale unit seen slopes matrix shares source factor offset rows"
ARRAYS += " flags counts"


class Judge(Protocol):
    """Raises what there is to say about a status."""

    def judge(self, status: int, /) -> None: ...


@dataclass(frozen=True)
class Filler:
    """Fills the structures of loops.

    at        the address of an array, which stays alive
    program   calls as instructions
    judges    address of a structure -> what judges the statuses that C has of it
    """

    at: Callable[[NDArray[Any]], int]
    program: Callable[[Sequence[Call]], layout.Program]
    judges: dict[int, Judge]

    def loop(self, loop: Loop) -> layout.Loop:
        """A loop; TypeError where a component is no FMU that C can call."""
        members = (layout.Member * len(loop.members))()
        for made, member in zip(members, loop.members, strict=True):
            self._fill(made, member)
        found = layout.Loop(
            members=members,
            **{name: self.at(getattr(loop.newton, name)) for name in ARRAYS.split()},
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
        made.trusted, told = self.at(member.trusted), member.derivative
        if told is None:
            return
        if not isinstance(told, Derivative):
            raise TypeError(f"{told!r} cannot be called from C")
        made.derivative, made.component, made.fmi = told.address, told.component, told.fmi
        made.of, made.by = self.at(told.of), self.at(told.by)
        self.judges[ctypes.addressof(made)] = told
