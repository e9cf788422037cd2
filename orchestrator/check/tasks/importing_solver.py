"""Tasks on Model Exchange as importers use it: nominal values, calls after initialisation, stiffness."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Integrator, Simulation, numeric, usual_step
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.instance import CallFailed

MAX_EIGENVALUES = 60  # of larger models the outermost eigenvalues
SHIFT = 1e-6  # of a state for finite differences, relative to nominal
MIN_DAMPING = 1e-3  # damping ratio; a smaller one may be rounding error of the differences
CHANGE = 1e-3  # of a parameter, relative to its magnitude


@contextmanager
def _simulation(trial: Trial) -> Iterator[Simulation]:
    """A run whose instance is terminated and freed at the end; other probes check the status of that."""
    simulation = Simulation(trial)
    yield simulation
    with suppress(CallFailed):
        simulation.instance.call("Terminate")
    simulation.instance.free()


@contextmanager
def _initialised(trial: Trial) -> Iterator[tuple[Simulation, Integrator]]:
    """The same after initialisation, in event mode."""
    with _simulation(trial) as simulation:
        simulation.initialise()
        yield simulation, Integrator(simulation.instance, trial.description)


def nominals(trial: Trial) -> Iterator[Remark]:
    """Nominal values of states are positive, because solvers scale their absolute tolerances with them."""
    with _initialised(trial) as (_, integrator):
        for i, value in enumerate(integrator.nominals()):
            if not 0 < value < math.inf:
                states = trial.description.states
                name = states[i].name if i < len(states) else f"state {i}"
                yield "error", f"the nominal value of {name} is {value:g}, expected a value above 0"
                return


def late(trial: Trial) -> Iterator[Remark]:
    """Parameters, states and time can be set in event mode after initialisation, as OpenModelica does.

    The standard does not allow these calls, so an FMU may reject them, but then OpenModelica cannot simulate
    it. Each call gets a new instance, because after a failed call an FMU may reject all others.
    """
    parameters = [v for v in numeric(trial.description, "parameter") if v.variability == "fixed"]
    for v in [v for v in parameters if v.is_real and v.size == 1][:1]:
        with _initialised(trial) as (simulation, _):
            yield from _late_parameter(simulation, v)
    with _initialised(trial) as (_, integrator):
        yield from _late("states", lambda: integrator.set_states(integrator.states()))
    with _initialised(trial) as (simulation, _):
        yield from _late("the time", lambda: simulation.instance.set_time(simulation.start))


def _late(quantity: str, call: Callable[[], None]) -> Iterator[Remark]:
    """A remark if a call fails in event mode."""
    try:
        call()
    except CallFailed as failure:
        yield "note", f"{quantity} cannot be set before fmi2EnterContinuousTimeMode: {failure}"


def _late_parameter(simulation: Simulation, v: FmuVariable) -> Iterator[Remark]:
    """A remark if a new value of a parameter is rejected, or accepted without effect."""
    values = simulation.values([v])
    (old,) = values.get()
    low, high = v.bounds
    new = min(max(old + CHANGE * max(abs(old), v.scale), low), high)
    try:
        values.set([new])
        (actual,) = values.get()
    except CallFailed as failure:
        yield "note", f"parameters cannot be set after fmi2ExitInitializationMode: {failure}"
        return
    if actual != new:
        text = f"{v.name} is set to {new:.9g} after fmi2ExitInitializationMode with status OK"
        yield "note", f"{text}, but remains {actual:.9g}"


def stiff(trial: Trial) -> Iterator[Remark]:
    """Explicit Euler, the default of some importers, is stable with the step size of the default experiment.

    A decaying mode with eigenvalue a decays with steps h, too, if |1 + h a| < 1, that is,
    h < 2 |Re a| / |a|^2. A growing mode sets no limit.
    """
    with _simulation(trial) as simulation:
        integrator = simulation.begin().integrator
        assert integrator is not None
        try:
            eigenvalues = _eigenvalues(integrator) if integrator.count else []
        except CallFailed:
            return
    decaying = [a for a in eigenvalues if a.real < -MIN_DAMPING * abs(a)]
    limit, real, imaginary = min(
        ((-2 * a.real / abs(a) ** 2, a.real, abs(a.imag)) for a in decaying), default=(math.inf, 0.0, 0.0)
    )
    if limit < usual_step(trial.description):
        oscillates = imaginary > MIN_DAMPING * abs(real)
        eigenvalue = f"{real:.2g} +- {imaginary:.2g}i" if oscillates else f"{real:.2g}"
        solver = "a solver of higher order" if imaginary > abs(real) else "an implicit solver"
        text = f"an eigenvalue of {eigenvalue} 1/s: explicit Euler needs steps below {limit:.2g} s"
        yield "note", f"{text}, use {solver}"


def _eigenvalues(integrator: Integrator) -> Sequence[complex]:
    """Eigenvalues of the Jacobian at the current point; of a large model about the outermost ones.

    Arnoldi iteration, whose Jacobian-vector products are finite differences of the derivatives. States are
    scaled with their nominal values.
    """
    x, shift, time = integrator.states(), SHIFT * integrator.nominal, integrator.time
    base, size = integrator.derivatives_at(time, x), min(len(x), MAX_EIGENVALUES)
    basis, h = np.zeros((size + 1, len(x))), np.zeros((size + 1, size))
    start = np.random.default_rng(0).normal(size=len(x))
    basis[0] = start / np.linalg.norm(start)
    for k in range(size):
        w = (integrator.derivatives_at(time, x + shift * basis[k]) - base) / shift
        if not np.isfinite(w).all():
            return []
        for _ in range(2):  # orthogonalised twice against rounding
            projection = basis[: k + 1] @ w
            h[: k + 1, k] += projection
            w -= projection @ basis[: k + 1]
        h[k + 1, k] = np.linalg.norm(w)
        if h[k + 1, k] <= SHIFT**2 * np.abs(h).max():  # an invariant subspace: all eigenvalues in reach
            size = k + 1
            break
        basis[k + 1] = w / h[k + 1, k]
    return [complex(a) for a in np.linalg.eigvals(h[:size, :size])]
