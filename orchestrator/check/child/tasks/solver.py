"""What importers for model exchange do: nominal values, calls around the initialisation, stiffness."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from orchestrator.check.child.binary import Refused
from orchestrator.check.child.description import Variable
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.model_exchange import Exchange
from orchestrator.check.child.player import Player, Values

if TYPE_CHECKING:
    from numpy import float64
    from numpy.typing import NDArray

    Vector = NDArray[float64]

MODES = 60  # eigenvalues at most; of more states the outermost
SHIFT = 1e-6  # of the nominal values
DAMPED = 1e-3  # of a decaying mode: the real part over the magnitude, below is rounding of the differences
CHANGE = 1e-3  # of a parameter


@contextmanager
def _played(bench: Bench) -> Iterator[Player]:
    """An instance that is freed at the end. What it says to that, other probes judge."""
    player = bench.player()
    yield player
    with suppress(Refused):
        player.instance.terminate()
    player.instance.free()


def _initialised(player: Player) -> Exchange:
    """In event mode, where the initialisation ends."""
    player.instance.enter(player.start)
    player.instance.leave()
    return Exchange(player.instance)


def nominals(bench: Bench) -> Iterator[Said]:
    """Nominal values of states are positive: solvers make their absolute tolerances of them."""
    with _played(bench) as player:
        exchange = _initialised(player)
        if exchange.count == 0:
            return
        values = (ctypes.c_double * exchange.count)()
        player.instance.call("GetNominalsOfContinuousStates", values, ctypes.c_size_t(exchange.count))
        wrong = next((i for i, value in enumerate(values) if not 0 < value < math.inf), None)
        if wrong is not None:
            states = bench.declared.states
            name = states[wrong] if wrong < len(states) else f"state {wrong}"
            yield "error", f"the nominal value of {name} is {values[wrong]:g}, expected one above 0"


def late(bench: Bench) -> Iterator[Said]:
    """OpenModelica's import sets parameters, states and time between initialisation and continuous-time mode.

    The standard does not foresee it, so a refusal is no fault; but the import then does not run. Each has an
    instance of its own: after a refusal an FMU may refuse whatever follows.
    """
    for v in _parameters(bench)[:1]:
        with _played(bench) as player:
            _initialised(player)
            yield from _late_parameter(player, v)
    with _played(bench) as player:
        exchange = _initialised(player)
        yield from _late("states", lambda: exchange.put_states(exchange.states()))
    with _played(bench) as player:
        exchange = _initialised(player)
        yield from _late("the time", lambda: exchange.put_time(player.start))


def _late(what: str, call: Callable[[], None]) -> Iterator[Said]:
    """What is refused in event mode."""
    try:
        call()
    except Refused as refusal:
        yield "note", f"{what} cannot be set before fmi2EnterContinuousTimeMode: {refusal}"


def _late_parameter(player: Player, v: Variable) -> Iterator[Said]:
    """Is another value of a parameter refused, or passed over?"""
    one = Values(player.instance, [v])
    (old,) = one.get()
    wanted = min(max(old + CHANGE * max(abs(old), v.scale), v.low), v.high)
    try:
        one.set([wanted])
        (found,) = one.get()
    except Refused as refusal:
        yield "note", f"parameters cannot be set after fmi2ExitInitializationMode: {refusal}"
        return
    if found != wanted:
        text = f"{v.name} is set to {wanted:.9g} after fmi2ExitInitializationMode and stays {found:.9g}"
        yield "note", f"{text}, and the status is OK"


def _parameters(bench: Bench) -> list[Variable]:
    """Fixed parameters that are scalar numbers."""
    fixed = [v for v in bench.declared.of("parameter") if v.variability == "fixed"]
    return [v for v in fixed if v.is_float and v.size == 1]


def stiff(bench: Bench) -> Iterator[Said]:
    """Can explicit Euler, which some importers take by default, step the model as its experiment suggests?

    A mode with eigenvalue a decays in steps h too where |1 + h a| < 1, that is, h < 2 |Re a| / |a|^2. A mode
    that grows sets no limit.
    """
    with _played(bench) as player:
        exchange = player.begin().exchange
        assert exchange is not None
        try:
            modes = _modes(exchange) if exchange.count else []
        except Refused:
            return
    decaying = [a for a in modes if a.real < -DAMPED * abs(a)]
    limit, real, imaginary = min(
        ((-2 * a.real / abs(a) ** 2, a.real, abs(a.imag)) for a in decaying), default=(math.inf, 0.0, 0.0)
    )
    if limit < bench.declared.step:
        swings = imaginary > DAMPED * abs(real)
        mode = f"{real:.2g} +- {imaginary:.2g}i" if swings else f"{real:.2g}"
        solver = "a solver of higher order" if imaginary > abs(real) else "an implicit solver"
        yield (
            "note",
            f"an eigenvalue of {mode} 1/s: explicit Euler wants steps below {limit:.2g} s, take {solver}",
        )


def _modes(exchange: Exchange) -> Sequence[complex]:
    """Eigenvalues of the Jacobian as it is now, of a large one about the outermost: Arnoldi's iteration.

    Its products with vectors are differences of derivatives; the states are in units of their nominal values.
    """
    import numpy as np  # here, for the other probes start without

    x, shift, time = np.array(exchange.states()), SHIFT * np.array(exchange.nominal), exchange.time
    base, most = _slope(exchange, time, x), min(len(x), MODES)
    basis, h = np.zeros((most + 1, len(x))), np.zeros((most + 1, most))
    start = np.random.default_rng(0).normal(size=len(x))
    basis[0] = start / np.linalg.norm(start)
    for k in range(most):
        w = (_slope(exchange, time, x + shift * basis[k]) - base) / shift
        if not np.isfinite(w).all():
            return []
        for _ in range(2):  # once more, for rounding
            along = basis[: k + 1] @ w
            h[: k + 1, k] += along
            w -= along @ basis[: k + 1]
        h[k + 1, k] = np.linalg.norm(w)
        if h[k + 1, k] <= SHIFT**2 * np.abs(h).max():  # nothing new: these are all
            most = k + 1
            break
        basis[k + 1] = w / h[k + 1, k]
    return [complex(a) for a in np.linalg.eigvals(h[:most, :most])]


def _slope(exchange: Exchange, time: float, x: Vector) -> Vector:
    import numpy as np

    exchange.put(time, x.tolist())
    return np.array(exchange.derivatives())
