"""FMI 3: the intermediate update inside a step, and its early return."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from orchestrator.check.child.binary import Refused
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.player import Values, bits

_B = ctypes.c_bool
Callback = ctypes.CFUNCTYPE(
    *(None, ctypes.c_void_p, ctypes.c_double, _B, _B, _B, _B),
    *(ctypes.POINTER(_B), ctypes.POINTER(ctypes.c_double)),
)
STEPS = 6


@dataclass
class Witness:
    """The callback: keeps the times, reads the outputs where it may, and asks for a return where it shall."""

    ask: bool = False
    times: list[float] = field(default_factory=list)
    values: Values | None = None
    problem: str = ""

    def callback(self) -> Any:
        """The C function."""
        return Callback(self._call)

    def _call(
        self, _: Any, time: float, __: bool, get: bool, ___: bool, can: bool, asked: Any, at: Any
    ) -> None:
        self.times.append(time)
        if get and self.values is not None and not self.problem:
            try:
                self.values.get()
            except Refused as refusal:
                self.problem = str(refusal)
        if asked:
            asked[0] = bool(self.ask and can)
        if at:
            at[0] = time


def intermediate(bench: Bench) -> Iterator[Said]:
    """Updates lie within the step, outputs can be read there, and the results stay the same bits."""
    plain = bench.player().begin()
    expected = plain.run(STEPS, bench.pokes)
    witness = Witness()
    callback = witness.callback()
    player = bench.player(update=callback).begin()
    witness.values = Values(player.instance, [v for v in bench.declared.of("output") if v.is_float])
    rows = []
    for n in range(STEPS):
        witness.times.clear()
        rows += player.run(1, bench.pokes)
        begin, slack = player.start + n * player.step, 1e-9 * max(player.step, abs(player.time))
        wrong = [t for t in witness.times if not begin - slack <= t <= player.time + slack]
        if wrong:
            yield (
                "error",
                f"an update at {wrong[0]:.9g} s in the step from {begin:.9g} to {player.time:.9g} s",
            )
            return
        if witness.times != sorted(witness.times):
            yield "error", f"the updates of the step from {begin:.9g} s go back in time"
            return
    if witness.problem:
        yield "error", f"in the intermediate update {witness.problem}"
    elif bits(rows) != bits(expected):
        text = bench.difference(expected, rows)
        yield "error", f"results change when outputs are read in the intermediate update: {text}"
    player.close()


def early_return(bench: Bench) -> Iterator[Said]:
    """A step that is asked to return early does, tells where, and the next one goes on from there."""
    witness = Witness(ask=True)
    callback = witness.callback()
    player = bench.player(update=callback, early=True).begin()
    time, instance = player.start, player.instance
    for _ in range(STEPS):
        reached = instance.step(time, player.step)
        end = time + player.step
        if not instance.returned_early:
            if not abs(reached - end) <= 1e-9 * end + bench.declared.inner_step:
                text = f"a step from {time:.9g} to {end:.9g} s ends at {reached:.9g} s"
                yield "error", f"{text} and does not say that it returned early"
                return
            reached = end
        elif not time <= reached <= end * (1 + 1e-12):
            yield (
                "error",
                f"the last successful time of a step from {time:.9g} to {end:.9g} s is {reached:.9g} s",
            )
            return
        time = reached
    player.close()
