"""Measured orders of convergence, on the undamped two-mass oscillator with its exact solution.

An error that falls with the p-th power of the step falls by 2^p when the step is halved. The steps are so
short that the next term of the error's expansion bends the measured order by a few hundredths only, and so
long that the error stays above that of the FMUs themselves, which is 4e-10 of the largest position in 10 s.
"""

import numpy as np
import pytest

from orchestrator import assemble, reference, run
from orchestrator.base.coupling import Coupling
from orchestrator.monolithic.tight import estimated_error

FINE = (2e-3, 1e-3)  # [s]; 0.066 and 0.033 rad of the fast oscillation
COARSE = (3.2e-2, 1.6e-2, 8e-3)  # for iterated masters, whose errors are small
CONVERGED = {"passes": 40, "tolerance": 1e-12}  # nothing changes any more
NEAR = 0.06  # of the order: measured within 0.04 at these steps


def errors(system, exact, coupling, steps, stop=1.0):
    """Error of the first position at each step, relative to the largest position."""
    found = []
    for h in steps:
        trace = run(system, master=coupling, step=h, stop=stop).trace
        truth = exact(trace.time)[:, 0]
        found.append(np.abs(trace["a.x"] - truth).max() / np.abs(truth).max())
    return found


def order(system, exact, coupling, steps=FINE):
    """The order that the last two steps measure."""
    *_, before, after = errors(system, exact, coupling, steps)
    return np.log2(before / after)


@pytest.mark.parametrize("n", [0, 1, 2, 3])
@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("follow", ["curves", "lines", "rates"])
def test_a_source_continued_at_order_n_gives_order_n_plus_one(oscillators, exact, master, n, follow):
    """Inputs are cubics, or the nearest straight lines, whose error is of the order h^4."""
    found = order(oscillators(follow), exact, Coupling(master, n), (4e-3, 2e-3) if n == 3 else FINE)
    assert found == pytest.approx(n + 1, abs=NEAR)


@pytest.mark.parametrize("n", [0, 1, 2])
@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_the_correction_raises_the_order_by_one(oscillators, exact, master, n):
    """The deficit of the mean is corrected one step later, so only its change remains."""
    coupling = Coupling(master, n, correct=True)
    steps = (4e-3, 2e-3) if n == 2 else FINE
    assert order(oscillators(), exact, coupling, steps) == pytest.approx(n + 2, abs=NEAR)


def test_one_pass_of_hermite_has_order_four(moving, exact):
    """Cubic extrapolation, and cubic interpolation for sources that have stepped."""
    found = order(moving, exact, Coupling("hermite", guard=0, passes=1), (4e-3, 2e-3))
    assert found == pytest.approx(4, abs=NEAR)


@pytest.mark.parametrize("passes", [2, 40])
@pytest.mark.parametrize("follow", ["curves", "lines", "rates"])
def test_iterated_hermite_has_order_four(oscillators, exact, passes, follow):
    """Every input is the cubic through both ends, up to h^4; lines keep its mean and first moment."""
    coupling = Coupling("hermite", guard=0, passes=passes, tolerance=1e-12)
    assert order(oscillators(follow), exact, coupling, COARSE) == pytest.approx(4, abs=NEAR)


def test_rates_of_fmi_3_do_as_well(oscillators, exact):
    """The line by rate inputs in FMI 3.0 is the line by input derivatives in FMI 2.0, bit for bit."""
    coupling = Coupling("hermite", guard=0, **CONVERGED)
    lines, rates = (
        errors(s, exact, coupling, COARSE) for s in (oscillators("lines"), oscillators("rates", 3))
    )
    assert lines == rates


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmus_that_hold_their_inputs_keep_order_two(oscillators, exact, fmi):
    """Held inputs have the right mean; the error of the first moment remains, also after repetition."""
    found = order(
        oscillators("held", fmi), exact, Coupling("hermite", guard=0, **CONVERGED), (1.6e-2, 8e-3, 4e-3)
    )
    assert found == pytest.approx(2, abs=NEAR)


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_fmus_that_hold_their_inputs_gain_from_slopes(oscillators, exact, master, n):
    """The mean of the extrapolated source raises the order from 1 to 2.

    The force of the first mass follows its input at once, which it holds: its FMU tells a slope that lacks
    that of the input, by which the mean would be wrong in first order. Differences of values are not.
    """
    system = oscillators("held")
    assert order(system, exact, Coupling(master, n)) == pytest.approx(2, abs=NEAR)
    assert not run(system, master=master, step=0.1, stop=0.1).card.notes
    (blind, _) = run(system, master=Coupling(master, n), step=1e-3, stop=1e-2).card.notes
    assert blind == (
        "input derivatives from differences of values, because the FMUs provide no output "
        "derivatives: a.force"
    )


@pytest.mark.parametrize("follow", ["curves", "rates", "held"])
@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("n", [1, 2])
def test_without_slopes_continuing_has_order_two(oscillators, exact, master, n, follow):
    """In the first step there are no slopes: inputs are held, and an error of h^2 remains."""
    system = oscillators(follow, slopes=False)
    assert order(system, exact, Coupling(master, n)) == pytest.approx(2, abs=NEAR)


def test_without_slopes_a_flat_start_has_the_full_order(fmus):
    """Without an error in the first step, differences of values are as good as slopes of FMUs.

    An integrator behind a sine from its top on; the sine tells no slope.
    """
    files = {"sine": fmus["source"], "sum": fmus.make("fails", "summing", interpolates=True)}
    system = assemble(files, ["sine.y -> sum.u"])
    top, found = np.pi / 2, []
    for h in (0.05, 0.025):
        trace = run(system, master=Coupling("jacobi", 2), step=h, start=top, stop=top + 1.0).trace
        found.append(abs(trace["sum.y"][-1] - np.sin(1.0)))
    assert np.log2(found[0] / found[1]) == pytest.approx(3, abs=NEAR)


def test_without_slopes_iterated_hermite_keeps_order_four(oscillators, exact):
    """Differences over four values are exact for cubics, and passes correct the first step.

    They reach back three steps, so that short steps are needed for the order: it comes down to 4 from above.
    """
    coupling = Coupling("hermite", guard=0, **CONVERGED)
    for follow in ("curves", "rates"):
        found = errors(oscillators(follow, slopes=False), exact, coupling, (1.6e-2, 8e-3, 4e-3))
        first, second = np.log2(np.array(found[:-1]) / found[1:])
        assert 3.9 < second < first < 4.4, found


@pytest.mark.parametrize("able", [{}, {"slopes": False}, {"canGetAndSetFMUstate": "false"}])
@pytest.mark.parametrize("follow", ["curves", "rates", "held"])
def test_the_reference_without_model_exchange_is_as_exact_as_it_says(oscillators, exact, follow, able):
    """Whatever the FMUs can do, the true error is near the estimate on the card."""
    result = reference(oscillators(follow, **able), stop=1.0, record_step=0.01)
    truth = exact(result.trace.time)
    estimates = {e.name: estimated_error(e) for e in result.card.errors}
    for signal, values in (("a.x", truth[:, 0]), ("b.x", truth[:, 1])):
        error = np.sqrt(np.mean((result.trace[signal] - values) ** 2)) / np.ptp(values)
        # 4e-10: the error of the FMUs themselves, here over the range
        assert error < 1.5 * estimates[signal] + 4e-10, (signal, error, estimates[signal])
    note = result.card.notes[-1]
    assert "co-simulation with a small step: estimated RMS error at most" in note
