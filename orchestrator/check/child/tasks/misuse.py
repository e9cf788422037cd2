"""What nobody should do and somebody does: values that are no numbers, calls in a wrong state."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Sequence

from orchestrator.check.child.binary import Missing, Refused
from orchestrator.check.child.description import Variable
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.player import Player, Values, movable, odd

INPUTS = 20  # looked at
STEPS = 3
BAD = (("nan", math.nan), ("inf", math.inf), ("1e120", 1e120), ("-1e120", -1e120))


def values(bench: Bench) -> Iterator[Said]:
    """A value without sense is refused, or at least does no lasting harm under the status OK."""
    found: dict[str, list[str]] = {}
    stage = 0
    for v in [v for v in movable(bench.declared) if v.size == 1][:INPUTS]:
        for word, value in BAD:
            if stage >= bench.first and not (v.kind == "Float32" and abs(value) > 1e38):
                bench.at(stage)
                harm = _harm(bench, v, value)
                if harm:
                    found.setdefault("nan" if word == "nan" else "huge", []).append(
                        f"{v.name} = {word}: {harm}"
                    )
            stage += 1
    for texts in found.values():
        more = f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""
        yield "warning", f"a senseless input comes back as OK: {texts[0]}{more}"


def _harm(bench: Bench, v: Variable, value: float) -> str:
    """What a value does; empty when it is refused or harmless."""
    player = bench.player(inputs=[v])
    try:
        player.begin()
        player.inputs.set([value])
        rows = player.run(STEPS)
        names = player.outputs.names
        bad = _first_odd(names, rows)
        if bad and math.isnan(value):
            player.inputs.set(player.rest)
            bad = _first_odd(names, player.run(STEPS))
            bad = f"{bad} even after the input is valid again" if bad else ""
        elif bad and math.isinf(value):
            bad = ""  # what goes in infinite may come out infinite
    except Refused:
        return ""
    return bad


def _first_odd(names: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    return next((odd(names, row) for row in rows if odd(names, row)), "")


# ---- calls in a wrong state


def order(bench: Bench) -> Iterator[Said]:
    """No call in a wrong state ends the process."""
    for stage, (name, case) in enumerate(CASES.items()):
        if stage < bench.first:
            continue
        bench.at(stage)
        bench.beacon.inputs(f"({name})")
        player = bench.player()
        try:
            case(player)
        except (Refused, Missing):
            continue
        finally:
            player.instance.binary.log.messages.clear()
    return
    yield


def _enter_twice(player: Player) -> None:
    player.instance.enter()
    player.instance.enter()


def _begun(*calls: Callable[[Player], object]) -> Callable[[Player], None]:
    """A case that starts with an initialised instance."""

    def case(player: Player) -> None:
        player.begin()
        for call in calls:
            call(player)

    return case


def _move(player: Player) -> None:
    if player.instance.side == "cs":
        player.instance.step(player.time, player.step)
    else:
        player.instance.status("SetTime", ctypes.c_double(player.time + player.step))


def _length(length: float) -> Callable[[Player], None]:
    def case(player: Player) -> None:
        if player.instance.side == "cs":
            player.instance.step(player.time, length)

    return case


def _unknown(player: Player) -> None:
    """Read a variable that does not exist."""
    ghost = Variable("ghost", "Real" if player.instance.declared.major == 2 else "Float64", 0x7FFFFFF0)
    Values(player.instance, [ghost]).get()


def _nothing(player: Player) -> None:
    """Read no variables: null pointers are allowed."""
    kind = "Real" if player.instance.declared.major == 2 else "Float64"
    none, zero = ctypes.c_void_p(None), ctypes.c_size_t(0)
    extra = [zero] if player.instance.declared.major == 3 else []
    player.instance.call(f"Get{kind}", none, zero, none, *extra)


def _fixed(player: Player) -> None:
    """Set parameters after the initialisation."""
    for v in [v for v in player.instance.declared.of("parameter") if v.start][:5]:
        Values(player.instance, [v]).set((v.start * v.size)[: v.size])


def _no_state(player: Player) -> None:
    """Free no state: to be ignored."""
    if player.instance.declared.can(player.instance.side, "canGetAndSetFMUstate", "canGetAndSetFMUState"):
        player.instance.forget(ctypes.c_void_p(None))


def _terminate(player: Player) -> None:
    player.instance.terminate()


def _free(player: Player) -> None:
    player.instance.free()


def _free_nothing(player: Player) -> None:
    player.instance.binary.raw("FreeInstance", ctypes.c_void_p(None), result=None)


CASES: dict[str, Callable[[Player], object]] = {
    "a step before the initialisation": _move,
    "outputs before the initialisation": lambda p: p.row(),
    "terminated before the initialisation": _terminate,
    "freed right after instantiation": _free,
    "no initialisation mode to leave": lambda p: p.instance.leave(),
    "initialisation mode entered twice": _enter_twice,
    "initialised twice": _begun(lambda p: p.begin()),
    "an unknown value reference": _begun(_unknown),
    "no variables, null pointers": _begun(_nothing),
    "parameters set while running": _begun(_fixed),
    "a step of no length": _begun(_length(0.0)),
    "a step backwards": _begun(_length(-1e-3)),
    "a step after the end": _begun(_terminate, _move),
    "terminated twice": _begun(_terminate, _terminate),
    "freed without an end": _begun(_free),
    "a reset after the end": _begun(_terminate, lambda p: p.instance.call("Reset"), lambda p: p.begin()),
    "no state freed": _begun(_no_state),
    "no instance freed": _free_nothing,
}
