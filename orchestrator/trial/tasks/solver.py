"""What importers for model exchange do: nominal values, calls around the initialisation, stiffness."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence

from orchestrator.trial.bench import Bench, Said
from orchestrator.trial.binary import Refused
from orchestrator.trial.declared import Variable
from orchestrator.trial.exchange import Exchange
from orchestrator.trial.player import Player
from orchestrator.trial.values import Values

TURNS = 30  # of the power iteration
SHIFT = 1e-6  # of the nominal values
STABLE = 2.0  # an explicit Euler step h is stable where h |eigenvalue| is below
CHANGE = 1e-3  # of a parameter


def nominals(bench: Bench) -> Iterator[Said]:
    """Nominal values of states are positive: solvers make their absolute tolerances of them."""
    player = bench.player()
    player.instance.enter(player.start)
    player.instance.leave()
    exchange = Exchange(player.instance)
    if exchange.count == 0:
        return
    values = (ctypes.c_double * exchange.count)()
    player.instance.call("GetNominalsOfContinuousStates", values, ctypes.c_size_t(exchange.count))
    for i, value in enumerate(values):
        if not 0 < value < math.inf:
            name = bench.declared.states[i] if i < len(bench.declared.states) else f"state {i}"
            yield "error", f"the nominal value of {name} is {value:g}, expected one above 0"
            return


def late(bench: Bench) -> Iterator[Said]:
    """OpenModelica's import sets parameters and states between initialisation and continuous-time mode.

    The standard does not foresee it, so a refusal is no fault; but the import then does not run.
    """
    player = bench.player()
    player.instance.enter(player.start)
    player.instance.leave()
    for v in _parameters(bench)[:1]:
        one = Values(player.instance, [v])
        (old,) = one.get()
        wanted = min(max(old + CHANGE * max(abs(old), v.scale), v.low), v.high)
        try:
            one.set([wanted])
            (found,) = one.get()
        except Refused as refusal:
            yield "note", f"parameters cannot be set after fmi2ExitInitializationMode: {refusal}"
            continue
        if found != wanted:
            text = f"{v.name} is set to {wanted:.9g} after fmi2ExitInitializationMode and stays {found:.9g}"
            yield "note", f"{text}, and the status is OK"
    exchange = Exchange(player.instance)
    if exchange.count:
        try:
            exchange.put(player.start, exchange.states())
        except Refused as refusal:
            yield "note", f"states cannot be set before fmi2EnterContinuousTimeMode: {refusal}"


def _parameters(bench: Bench) -> list[Variable]:
    """Fixed parameters that are scalar numbers."""
    fixed = [v for v in bench.declared.of("parameter") if v.variability == "fixed"]
    return [v for v in fixed if v.is_float and v.size == 1]


def stiff(bench: Bench) -> Iterator[Said]:
    """Can explicit Euler, which some importers take by default, step the model as its experiment suggests?"""
    player = bench.player().begin()
    assert player.exchange is not None
    if player.exchange.count == 0:
        return
    try:
        fastest = _fastest(player, player.exchange)
    except Refused:
        return
    if fastest * bench.declared.step > STABLE:
        text = f"stiff, an eigenvalue of {fastest:.2g} 1/s: explicit Euler wants steps below"
        yield "note", f"{text} {STABLE / fastest:.2g} s, take an implicit solver"


def _fastest(player: Player, exchange: Exchange) -> float:
    """About the largest magnitude of an eigenvalue of the Jacobian, by power iteration with differences."""
    x, scale = exchange.states(), exchange.nominal
    base = _slope(player, exchange, x)
    v, growth = [1.0 / math.sqrt(len(x))] * len(x), []
    for _ in range(TURNS):
        moved = [a + SHIFT * b * n for a, b, n in zip(x, v, scale, strict=True)]
        found = _slope(player, exchange, moved)
        w = [(a - b) / (SHIFT * n) for a, b, n in zip(found, base, scale, strict=True)]
        size = math.sqrt(sum(a * a for a in w))
        if not 0 < size < math.inf:
            return 0.0
        growth.append(size)
        v = [a / size for a in w]
    late_ = growth[TURNS // 2 :]
    return math.exp(sum(math.log(g) for g in late_) / len(late_))


def _slope(player: Player, exchange: Exchange, x: Sequence[float]) -> list[float]:
    exchange.put(player.time, x)
    return exchange.derivatives()
