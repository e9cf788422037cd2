"""What importers for model exchange do: nominal values, calls around the initialisation, stiffness."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import ContinuousStates, Simulation, numeric, usual_step
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.raw_description import DeclaredVariable

if TYPE_CHECKING:
    from numpy import float64
    from numpy.typing import NDArray

    Vector = NDArray[float64]

MODES = 60  # eigenvalues at most; of more states the outermost
SHIFT = 1e-6  # of the nominal values
DAMPED = 1e-3  # of a decaying mode: the real part over the magnitude, below is rounding of the differences
CHANGE = 1e-3  # of a parameter


@contextmanager
def _simulation(trial: Trial) -> Iterator[Simulation]:
    """A run whose instance is freed at the end. What it says to that, other probes judge."""
    simulation = Simulation(trial)
    yield simulation
    with suppress(CallFailed):
        simulation.instance.call("Terminate")
    simulation.instance.free()


@contextmanager
def _initialised(trial: Trial) -> Iterator[tuple[Simulation, ContinuousStates]]:
    """The same in event mode, where the initialisation ends."""
    with _simulation(trial) as simulation:
        simulation.initialise()
        yield simulation, ContinuousStates(simulation.instance, trial.description)


def nominals(trial: Trial) -> Iterator[Remark]:
    """Nominal values of states are positive: solvers make their absolute tolerances of them."""
    with _initialised(trial) as (_, exchange):
        for i, value in enumerate(exchange.nominals()):
            if not 0 < value < math.inf:
                states = trial.description.states
                name = states[i].name if i < len(states) else f"state {i}"
                yield "error", f"the nominal value of {name} is {value:g}, expected one above 0"
                return


def late(trial: Trial) -> Iterator[Remark]:
    """OpenModelica's import sets parameters, states and time between initialisation and continuous-time mode.

    The standard does not foresee it, so a refusal is no fault; but the import then does not run. Each has an
    instance of its own: after a refusal an FMU may refuse whatever follows.
    """
    parameters = [v for v in numeric(trial.description, "parameter") if v.variability == "fixed"]
    for v in [v for v in parameters if v.is_float and v.size == 1][:1]:
        with _initialised(trial) as (simulation, _):
            yield from _late_parameter(simulation, v)
    with _initialised(trial) as (_, exchange):
        yield from _late("states", lambda: exchange.put_states(exchange.states()))
    with _initialised(trial) as (simulation, _):
        yield from _late("the time", lambda: simulation.instance.set_time(simulation.start))


def _late(what: str, call: Callable[[], None]) -> Iterator[Remark]:
    """What is refused in event mode."""
    try:
        call()
    except CallFailed as failure:
        yield "note", f"{what} cannot be set before fmi2EnterContinuousTimeMode: {failure}"


def _late_parameter(simulation: Simulation, v: DeclaredVariable) -> Iterator[Remark]:
    """Is another value of a parameter refused, or passed over?"""
    one = simulation.values([v])
    (old,) = one.get()
    wanted = min(max(old + CHANGE * max(abs(old), v.scale), v.minimum), v.maximum)
    try:
        one.set([wanted])
        (found,) = one.get()
    except CallFailed as failure:
        yield "note", f"parameters cannot be set after fmi2ExitInitializationMode: {failure}"
        return
    if found != wanted:
        text = f"{v.name} is set to {wanted:.9g} after fmi2ExitInitializationMode and stays {found:.9g}"
        yield "note", f"{text}, and the status is OK"


def stiff(trial: Trial) -> Iterator[Remark]:
    """Can explicit Euler, which some importers take by default, step the model as its experiment suggests?

    A mode with eigenvalue a decays in steps h too where |1 + h a| < 1, that is, h < 2 |Re a| / |a|^2. A mode
    that grows sets no limit.
    """
    with _simulation(trial) as simulation:
        exchange = simulation.begin().exchange
        assert exchange is not None
        try:
            modes = _modes(exchange) if exchange.count else []
        except CallFailed:
            return
    decaying = [a for a in modes if a.real < -DAMPED * abs(a)]
    limit, real, imaginary = min(
        ((-2 * a.real / abs(a) ** 2, a.real, abs(a.imag)) for a in decaying), default=(math.inf, 0.0, 0.0)
    )
    if limit < usual_step(trial.description):
        swings = imaginary > DAMPED * abs(real)
        mode = f"{real:.2g} +- {imaginary:.2g}i" if swings else f"{real:.2g}"
        solver = "a solver of higher order" if imaginary > abs(real) else "an implicit solver"
        yield (
            "note",
            f"an eigenvalue of {mode} 1/s: explicit Euler wants steps below {limit:.2g} s, take {solver}",
        )


def _modes(exchange: ContinuousStates) -> Sequence[complex]:
    """Eigenvalues of the Jacobian as it is now, of a large one about the outermost: Arnoldi's iteration.

    Its products with vectors are differences of derivatives; the states are in units of their nominal values.
    """
    import numpy as np  # here, for the other probes start without

    def slope(x: Vector) -> Vector:
        return np.array(exchange.derivatives_at(time, x.tolist()))

    x, shift, time = np.array(exchange.states()), SHIFT * np.array(exchange.nominal), exchange.time
    base, most = slope(x), min(len(x), MODES)
    basis, h = np.zeros((most + 1, len(x))), np.zeros((most + 1, most))
    start = np.random.default_rng(0).normal(size=len(x))
    basis[0] = start / np.linalg.norm(start)
    for k in range(most):
        w = (slope(x + shift * basis[k]) - base) / shift
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
