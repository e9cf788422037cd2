"""Communication steps that are long, short, late or far from zero, and tolerances at both ends."""

import numpy as np
import pytest


def test_late_communication_points_lose_no_time(open_fmu):
    """Points 0.5 % of a step later than the last step ended: the gaps are integrated, too (4.2.2)."""
    fmu = open_fmu("path").start().set(position=1.0)
    for k in range(200):
        fmu.fmu.doStep(0.1005 * k, 0.1)
    # the integral of 1 is the time, rounding only
    assert fmu["integral"] == pytest.approx(199 * 0.1005 + 0.1, rel=1e-12)


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize(("start", "step"), [(1e6, 1e-9), (1e6, 1e-3), (1e9, 1e-5), (-3.0, 1e-12)])
def test_short_steps_far_from_zero(open_fmu, counted, start, step):
    """Rounding of the time, here up to a tenth of a step, is neither refused nor added up."""
    fmu = open_fmu("path").start(start).set(position=1.0)
    time = start
    for k in range(1000):
        if counted:
            time = start + k * step
        fmu.fmu.doStep(time, step)
        time += step
    # the integral of 1 is the sum of the steps, rounding of 1000 additions
    assert fmu["integral"] == pytest.approx(1000 * step, rel=1e-12, abs=0)


def test_step_that_does_not_move_the_time_is_refused(open_fmu):
    """A step of 1e-12 s at 1e6 s does not change the time; the message contains both."""
    fmu = open_fmu("path").start(1e6 + 0.125)
    fmu.refuses(lambda: fmu.fmu.doStep(1e6 + 0.125, 1e-12), "the step size is 1e-12 s at t = 1000000.125 s")


def test_inner_steps_do_not_depend_on_the_time(open_fmu):
    """A transient of 1 ns at tolerance 1e-9: the same bits at t = 0 and at t = 1e6 s."""
    step = 2.0**-20  # exact at both times
    found = []
    for start in (0.0, 1e6):
        fmu = open_fmu("decay").start(start, tolerance=1e-9, rate=1e9).set(target=3.0)
        found.append([fmu.step(step)["level"] for _ in range(3)])
    assert found[0] == found[1]


@pytest.mark.parametrize("tolerance", [1e-12, 1e-6, 1e-3, 0.9])
@pytest.mark.parametrize("count", [1, 1000])
def test_tolerance_bounds_the_error_at_any_step(open_fmu, tolerance, count):
    """Stiff and badly scaled, one step of 1 s or many of 1 ms: the pressure stays near a tight solution."""

    def pressure(tolerance, count):
        fmu = open_fmu("chamber").start(tolerance=tolerance).set(opening=0.5, supply=1e7)
        return fmu.step(1.0 / count, count)["pressure"]

    # error per inner step within the tolerance, none taken looser than 1e-3; they add up over a few steps
    bound = 10 * min(tolerance, 1e-3) + 1e-9
    assert pressure(tolerance, count) == pytest.approx(pressure(1e-11, 1), rel=bound)


def test_command_that_jumps_is_followed(open_fmu):
    """A target that jumps at each communication point, steps longer or shorter than the time constant."""
    for rate in (0.1, 1e3, 1e7, 1e9):
        fmu = open_fmu("decay").start(rate=rate)
        exact = 1.0
        for k, target in enumerate((5.0, -5.0, 90.0, -90.0, 0.0, 1.0)):
            fmu.set(target=target)
            fmu.fmu.doStep(float(k), 1.0)
            exact = target + (exact - target) * np.exp(-rate)
            # tolerance 1e-6 of 1 + |level|, over some ten inner steps
            assert fmu["level"] == pytest.approx(exact, abs=1e-5 * 181)


def test_stiff_lag_follows_a_moving_input(open_fmu):
    """Rate 1e7 1/s behind a cubic input: no order reduction beyond the tolerance (Prothero and Robinson)."""
    rate, step = 1e7, 0.02
    for tolerance in (1e-4, 1e-6, 1e-8):
        fmu = open_fmu("decay").start(tolerance=tolerance, rate=rate, level=-7.0 / rate)
        error = 0.0
        for k in range(50):
            t = k * step
            polynomial = np.polynomial.Polynomial([0.0, 7.0, -20.0, 13.0])
            fmu.set(target=polynomial(t))
            for order in (1, 2, 3):
                fmu.slopes(order, target=polynomial.deriv(order)(t))
            fmu.fmu.doStep(t, step)
            # the quasi-static solution: u - u'/k + u''/k^2 - u'''/k^3
            exact = sum((-1 / rate) ** i * polynomial.deriv(i)(t + step) for i in range(4))
            error = max(error, abs(fmu["level"] - exact))
        assert error <= tolerance
