"""The first values: right at once, before any step."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from orchestrator.trial.bench import Bench, Said
from orchestrator.trial.declared import Variable
from orchestrator.trial.instance import Instance
from orchestrator.trial.player import Player
from orchestrator.trial.values import Values


def first_output(bench: Bench) -> Iterator[Said]:
    """Values are right at once after initialisation, those that depend on inputs, too."""
    player = bench.player().begin()
    yield from _starts(bench, player.instance)
    before = player.row()
    if player.inputs.names:
        player.inputs.set(player.rest)
        yield from _settled(player, before, "inputs keep their start values")
    if bench.pokes:
        yield from _set_before(bench)
    if bench.side == "cs" and bench.can("canHandleVariableCommunicationStepSize"):
        yield from _tiny_step(bench, before)


def _settled(player: Player, before: Sequence[float], case: str) -> Iterator[Said]:
    after = player.row()
    scales = [v.scale for v in player.outputs.variables for _ in range(v.size)]
    for name, a, b, scale in zip(player.outputs.names, before, after, scales, strict=True):
        if abs(a - b) > 1e-9 * max(abs(a), abs(b), 1e-6 * scale):
            text = f"{name} is {a:.9g} after initialisation and {b:.9g} when the inputs are set again to"
            yield "error", f"{text} the same values ({case}): it is not evaluated at initialisation"
            return


def _set_before(bench: Bench) -> Iterator[Said]:
    player = bench.player()
    player.instance.enter(player.start)
    player.rest = player.inputs.get() if player.inputs.names else []
    player.poke(0)
    moved = player.inputs.get() if player.inputs.names else []
    player.instance.leave()
    player.settle()
    before = player.row()
    if player.inputs.names:
        player.inputs.set(moved)
        yield from _settled(player, before, "inputs were set in initialisation mode")


def _tiny_step(bench: Bench, first: Sequence[float]) -> Iterator[Said]:
    """An output of exactly 0 that jumps within no time and then hardly moves was not evaluated."""
    player = bench.player(step=1e-6 * bench.declared.step).begin()
    rows = player.run(2)
    if len(rows) < 2:
        return
    flat = [v for v in player.outputs.variables for _ in range(v.size)]
    for v, name, a, b, c in zip(flat, player.outputs.names, first, *rows, strict=True):
        steady = v.is_float and v.variability == "continuous"
        if steady and a == 0.0 and abs(b) > 1e-3 * v.nominal and abs(c - b) < 0.1 * abs(b):
            text = f"{name} is 0 after initialisation and {b:.6g} after a step of {player.step:.3g} s"
            yield "warning", f"{text}: it is not evaluated at initialisation"


def _starts(bench: Bench, instance: Instance) -> Iterator[Said]:
    """Parameters and inputs read what modelDescription.xml says."""
    known = [v for v in bench.declared.of("parameter", "input") if v.start]
    if not known:
        return
    values = Values(instance, known)
    wanted = [s for v in known for s in _spread(v)]
    for name, x, start in zip(values.names, values.get(), wanted, strict=True):
        # single precision holds seven digits
        if abs(x - start) > 1e-6 * max(abs(x), abs(start)) or math.isnan(x) != math.isnan(start):
            yield (
                "error",
                f"{name} starts at {start:.9g} in modelDescription.xml and at {x:.9g} in the binary",
            )
            return


def _spread(v: Variable) -> Sequence[float]:
    return v.start if len(v.start) == v.size else v.start[:1] * v.size
