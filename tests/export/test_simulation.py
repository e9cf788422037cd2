"""The solver, the inputs inside a step, and both FMI kinds against closed forms and each other."""

from math import factorial

import numpy as np
import pytest
from scipy.integrate import solve_ivp


@pytest.mark.parametrize("start", [0.0, 5.0, -2.5])
def test_decay_follows_the_exponential(open_fmu, start):
    """x' = k (u - x) from 1 with u = 0: exp(-k t) from any start time, and the output mixed = gain x + u."""
    fmu = open_fmu("decay").start(start).step(0.01, 100)
    # integrator error at tolerance 1e-6 per inner step, measured 2e-8
    assert fmu["level"] == pytest.approx(np.exp(-2.0), rel=1e-6)
    # exact identity, rounding only
    assert fmu["mixed"] == pytest.approx(3 * fmu["level"], rel=1e-14)


def oscillator(mu, force=lambda _: 0.0):
    """Van der Pol's equation."""
    return lambda t, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0] + force(t)]


def test_stiff_oscillator_follows_a_tight_solution(open_fmu):
    """Van der Pol's equation over a jump, against Radau at tolerance 1e-12."""
    fmu = open_fmu("vanderpol").start(tolerance=1e-8)
    found = []
    for n in range(100):
        fmu.fmu.doStep(0.1 * n, 0.1)
        found.append(fmu.get("x", "v"))
    tight = {"method": "Radau", "rtol": 1e-12, "atol": 1e-12}
    truth = solve_ivp(oscillator(5.0), (0, 10), [2, 0], t_eval=np.linspace(0.1, 10, 100), **tight)
    # tolerance 1e-8 per inner step; the jump amplifies errors some 100 times
    np.testing.assert_allclose(found, truth.y.T, atol=2e-5)


# the tightest tolerance for RODAS3 is 1e-5
@pytest.mark.parametrize(
    ("tolerance", "steps", "order"), [(9e-6, (80, 160, 320), 4), (0.99, (20, 40, 80), 3)]
)
def test_solver_converges_with_its_order(open_fmu, tolerance, steps, order):
    """With a tolerance too loose to act, one inner step per communication step: error ~ h^order."""

    def state(n):
        fmu = open_fmu("vanderpol")
        fmu.set(mu=1.0, force=1.0)
        fmu.slopes(force=-2.0)
        fmu.start(tolerance=tolerance)
        for k in range(n):
            fmu.set(force=1.0 - 2.0 * k / n)
            fmu.slopes(force=-2.0)
            fmu.fmu.doStep(k / n, 1 / n)
        return fmu.get("x", "v")

    forced = oscillator(1.0, lambda t: 1 - 2 * t)
    truth = solve_ivp(forced, (0, 1), [2, 0], "DOP853", rtol=1e-13, atol=1e-13)
    error = [np.abs(state(n) - truth.y[:, -1]).max() for n in steps]
    orders = np.log2(np.array(error[:-1]) / error[1:])
    # the next order's term is still 10 % of the error at these steps
    assert orders == pytest.approx([order, order], abs=0.3)


# ---- inputs inside a step ----------------------------------------------------------------------------


def exact(h, p, v=0.0, a=0.0, j=0.0):
    """Integral of p + v t + a t^2 / 2 + j t^3 / 6 from 0 to h."""
    return p * h + v * h**2 / 2 + a * h**3 / 6 + j * h**4 / 24


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_input_derivatives_act_as_a_polynomial_for_one_step(open_fmu, order):
    """fmi2SetRealInputDerivatives of each order, or none: the integral, and the input's value at the end."""
    fmu = open_fmu("path").start().set(position=3.0)
    if order:
        fmu.slopes(order, position=7.0)
    terms = [7.0 if n == order else 0.0 for n in (1, 2, 3)]
    fmu.step(0.5)
    # polynomials up to order 3 are integrated exactly, rounding only
    assert fmu["integral"] == pytest.approx(exact(0.5, 3.0, *terms), rel=1e-13, abs=0)
    moved = sum(rate * 0.5**n / factorial(n) for n, rate in enumerate(terms, 1))
    assert fmu["position"] == pytest.approx(3.0 + moved, rel=1e-15)
    fmu.step(0.5)  # in which the input is held at the value that was last set
    assert fmu["integral"] == pytest.approx(exact(0.5, 3.0, *terms) + 1.5, rel=1e-13, abs=0)


def test_rate_ports_equal_input_derivatives(open_fmu):
    """Rate ports for velocity and acceleration have the effect of the same input derivatives."""
    wired, told = open_fmu("path").start(), open_fmu("path").start()
    for k in range(5):
        values = (np.sin(k), np.cos(k), -np.sin(k))
        wired.set(position=values[0], velocity=values[1], acceleration=values[2])
        told.set(position=values[0])
        told.slopes(1, position=values[1])
        told.slopes(2, position=values[2])
        for fmu in (wired, told):
            fmu.fmu.doStep(0.3 * k, 0.3)
        # the same numbers through the same operations
        assert (wired.get("integral", "position") == told.get("integral", "position")).all()
        # the velocity port moves too
        assert wired["velocity"] == values[1] + 0.3 * values[2]


def test_input_derivative_wins_over_rate_port(open_fmu):
    """A derivative set by the master replaces the rate port for that step."""
    fmu = open_fmu("path").start().set(position=1.0, velocity=100.0, acceleration=100.0)
    fmu.slopes(position=2.0)
    fmu.step(0.5)
    # rounding only
    assert fmu["integral"] == pytest.approx(exact(0.5, 1.0, 2.0), rel=1e-13, abs=0)


# ---- derivatives -------------------------------------------------------------------------------------


def test_output_derivatives_are_exact(open_fmu):
    """dy/dt = y_x dx + y_u du: of a state, of a mixed output, of an output with feed-through."""
    fmu = open_fmu("decay").start().set(target=1.0)
    fmu.slopes(target=0.5)
    fmu.step(0.2)
    rate = 2.0 * (fmu["target"] - fmu["level"])
    # the same formula in another order: rounding only
    assert fmu.output_slopes("level", "mixed") == pytest.approx([rate, 3 * rate + 0.5], rel=1e-14)
    path = open_fmu("path").start()
    path.set(position=1.0, velocity=2.0, acceleration=4.0)
    assert path.output_slopes("integral", "where") == [1.0, 2.0]
    path.step(0.5)
    assert path.output_slopes("where") == [4.0]


@pytest.mark.parametrize("known", ["pressure", "flow", "heat", "opening", "supply"])
def test_directional_derivatives_equal_central_differences(open_fmu, known):
    """Columns of the Jacobian of derivatives and outputs against central differences."""
    fmu = open_fmu("chamber", "me").start()
    states, inputs = ["pressure", "flow", "heat"], ["opening", "supply"]
    unknowns = ["der_pressure", "der_flow", "der_heat", "force", "pressure_rate"]
    point = dict(zip([*states, *inputs], [1.2e7, 3e-4, 50.0, 0.4, 2e7], strict=True))

    def evaluate(values):
        fmu.set_continuous_states(*(values[n] for n in states))
        return fmu.set(**{n: values[n] for n in inputs}).get(*unknowns)

    delta = 1e-4 * point[known]
    high, low = (evaluate(point | {known: point[known] + s * delta}) for s in (1, -1))
    evaluate(point)
    found = fmu.derivative(unknowns, [known])[:, 0]
    # central differences: curvature of relative size delta^2 = 1e-8, cancellation 1e-16 / 1e-4
    scale = np.abs(evaluate(point)).max() / point[known]
    np.testing.assert_allclose(found, (high - low) / (2 * delta), rtol=1e-6, atol=1e-11 * scale)


def test_directional_derivative_refuses_what_is_no_known(open_fmu):
    """The message contains the name, and all that is a known or an unknown in this phase."""
    fmu = open_fmu("chamber")

    def refuse(unknown: str, known: str, text: str) -> None:
        fmu.refuses(lambda: fmu.derivative([unknown], [known]), f"fmi2GetDirectionalDerivative: {text}")

    fmu.enter()
    expected = "an input, a parameter or a state with a start value"
    refuse("force", "pressure", f"pressure is not a known, expected {expected}")
    fmu.fmu.exitInitializationMode()
    refuse("force", "volume", "volume is not a known, expected an input or a state")
    expected = "an output, a derivative or a state"
    refuse("opening", "supply", f"opening is not an unknown, expected {expected}")


def test_model_without_states_steps(open_fmu):
    """A pure gain without states can be an FMU."""
    fmu = open_fmu("gain").start().set(left=3.0, right=4.0)
    fmu.slopes(left=1.0)
    fmu.step(0.5)
    assert fmu["product"] == 2 * 3.5 * 4.0
    assert fmu.output_slopes("product") == [8.0]
