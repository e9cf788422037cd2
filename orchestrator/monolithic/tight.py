"""A tight co-simulation with its own error estimate, in place of a monolithic solution.

For systems with an FMU that has no Model Exchange, or does not list its states and their derivatives. The
step is halved until the estimate meets a bound, hardly falls any more, or the next run would cost too much.
The estimate of a run compares it with those at half and at twice its step. It does not see errors that do not
depend on the step. So the solvers of the FMUs and the passes of the master get tight tolerances, and steps in
which an input jumps are divided by a guard.
"""

from collections.abc import Callable, Iterator
from math import ceil, inf

from orchestrator.engine.result import Result, RunFailed, SignalError, changes
from orchestrator.ssp.coupling import Coupling

GUARD = 1e-6  # estimated relative error of an input above which the first run divides a step
PASS_TOLERANCE = 1e-9  # relative mismatch of an input at which the passes over a step end
MASTER_ORDER = 4.0  # of convergence; a larger measured order is a coincidence
FMU_TOLERANCE = 1e-10  # of the solvers in the FMUs, relative
BOUND = 1e-6  # smallest bound of the estimated RMS error, relative to the range of a signal
LARGEST_STEP = 1e-3  # [s], of the first run
MAX_STEPS = 10**6  # of all runs together
STAGNATION = 0.7  # the estimate hardly falls if half the step leaves more than this fraction of it


def first_step(record_step: float, suggested: float) -> float:
    """The first step [s]: a fraction of the record step, not above the suggestion and LARGEST_STEP."""
    return record_step / ceil(record_step / min(record_step, suggested, LARGEST_STEP) - 1e-9)


def master(refinement: float) -> Coupling:
    """The master of the highest order that works with all FMUs; refinement: step over that of the first run.

    The guard gets stricter with the square of the step. Otherwise errors of divided steps, of which there are
    many if FMUs hold their inputs, would not fall with the step, and the estimate would miss them.
    """
    return Coupling("hermite", guard=GUARD * refinement**2, tolerance=PASS_TOLERANCE)


CoSimulate = Callable[[float, Coupling], Result]  # a run with a step [s] and a master


def tightened(run: CoSimulate, first: float, bound: float, reason: str) -> Result:
    """The run with the smallest estimated error; raises RunFailed if no run is complete.

    run      co-simulates; `first`: the step of the first run [s]
    bound    of the estimated RMS error of each signal, relative to its range; at least BOUND
    reason   why there is no monolithic solution, for the card
    """
    runs = _runs(run, first)
    coarse, last, error = None, next(runs), inf
    best = last
    for finer in runs:
        errors = changes(coarse, last, finer)
        largest = max(map(estimated_error, errors), default=0.0)
        if largest < error or error == inf:
            best = last.noted(errors=errors)
        if largest <= max(bound, BOUND) or largest > STAGNATION * error:
            break
        coarse, last, error = last, finer, largest
    return _with_note(best, reason)


def _runs(run: CoSimulate, first: float) -> Iterator[Result]:
    """Complete runs, each at half the step of the one before; the first ones may fail at too large a step."""
    complete, failure, step = False, None, first
    spent = last = 0.0
    while spent + 2 * last <= MAX_STEPS:
        try:
            result = run(step, master(step / first))
        except RunFailed as failed:
            result, failure = failed.result, failed
            if complete or failed.final:
                break
        else:
            complete = True
            yield result
        last = max(result.card.steps, first / step)  # also of runs that fail at the start
        spent, step = spent + last, step / 2
    if failure and not complete:
        raise failure


def estimated_error(change: SignalError) -> float:
    """RMS error, over range, of a run that changes by this much when its step is halved; NaN is infinite."""
    order = min(max(change.order or 1.0, 1.0), MASTER_ORDER)
    error = change.rms * 2**order / (2**order - 1)
    return error if error == error else inf


def _with_note(result: Result, reason: str) -> Result:
    """The result with the reason and the largest estimate on its card."""
    worst = max(result.card.errors, key=estimated_error, default=None)
    estimate = "no estimate of its error, because no output changes or there is no run at half the step"
    if worst:
        estimate = f"estimated RMS error at most {estimated_error(worst):.1e} of range, in {worst.name}"
    what = "no monolithic solution, but a co-simulation with a small step"
    return result.noted(f"{what}: {estimate}; reason: {reason}")
