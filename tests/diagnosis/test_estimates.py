"""Least squares of the diagnosis: sizes are those of other libraries, and deviations are right."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import nnls

from fmus.diagnosis.axis import Effort
from fmus.diagnosis.estimates import Fit, Prior, few, gathered, judged
from fmus.diagnosis.weight import NOISE, Load, Tare

RNG = np.random.default_rng(5)


def states(fit, columns, right):
    """Sums of the normal equations, without fading."""
    empty = SimpleNamespace(**dict.fromkeys(fit.states, 0.0))
    equations = [(list(c), y) for c, y in zip(columns, right, strict=True)]
    return SimpleNamespace(**{n: float(s) for n, s in fit.rates(empty, 1.0, equations, 1e9).items()})


def test_sizes_that_are_not_negative_are_those_of_scipy():
    """Of 200 random problems, some with zeros: to rounding of the normal equations."""
    for _ in range(200):
        a, y = RNG.normal(size=(8, 3)), RNG.normal(size=8)
        found = [float(v) for v in few(ca.SX(a.T @ a), ca.SX(a.T @ y), most=3)[0]]
        assert found == pytest.approx(nnls(a, y)[0], abs=1e-9)


def test_the_last_size_is_free(monkeypatch):
    """With one free column the best of all bounded solutions is found, as by search over the free one."""
    monkeypatch.setattr("fmus.diagnosis.estimates.ROUGH", 0.0)
    fit = Fit("f", ("a", "b", "c"))
    prior = Prior((1e6, 1e6, 1e6), (0, 0, 0), 1e-4, 1.0)  # a further size is worth nothing
    for _ in range(50):
        a, y = RNG.normal(size=(9, 3)), RNG.normal(size=9)
        found = np.array([float(s) for s, _ in fit.solved(states(fit, a, y), prior, 2)])
        split = np.column_stack([a, -a[:, 2]])  # a free size is the difference of two that are not negative
        best = nnls(split, y)[0]
        assert found == pytest.approx([best[0], best[1], best[2] - best[3]], abs=1e-6)


def test_one_fault_is_no_sum_of_others():
    """Of a leak that two others together explain as well, it alone is told, with its own deviation."""
    fit, prior = Fit("f", ("a", "b", "c", "free")), Prior((100,) * 4, (0,) * 4, 1.0, 1.0)
    for _ in range(50):
        a = np.abs(RNG.normal(3, 1, size=(40, 4)))
        a[:, 2] = a[:, 0] + a[:, 1] + 1e-3 * RNG.normal(size=40)
        a[:, 3] = RNG.normal(size=40)
        solution = fit.solved(states(fit, a, 2 * a[:, 2] + RNG.normal(size=40)), prior, 3)
        *others, (size, off) = [*solution][:3]
        assert [float(s) for s, _ in others] == [0, 0]
        assert float(size) == pytest.approx(2, abs=4 * float(off))
        assert float(off) < 0.05  # 1/sqrt(40 (6^2 + 2)) = 0.026


def test_what_is_not_certain_is_no_size():
    """Noise alone makes no size that is rare, but for one in some hundred; it makes a free one."""
    fit, prior, found = Fit("f", ("a", "free")), Prior((100, 100), (0, 0), 1.0, 1.0), []
    for _ in range(300):
        a = RNG.normal(size=(20, 2))
        ((rare, _), (free, _)) = fit.solved(states(fit, a, RNG.normal(size=20)), prior, 1)
        found.append((float(rare) > 0, float(free) != 0))
    # one side of three deviations: 0.13 %
    assert np.mean(found, axis=0) == pytest.approx([0, 1], abs=0.015)


def test_equations_that_differ_more_are_a_change_not_noise():
    """The deviation grows with the residual up to `most`."""
    fit, a = Fit("f", ("a",)), np.ones((20, 1))
    jump = np.repeat([0.0, 10.0], 10)
    solutions = [fit.solved(states(fit, a, jump), Prior((100,), (0,), 1.0, 1.0, most)) for most in (2, 1e9)]
    offs = [float(off) for ((_, off),) in solutions]
    assert offs == pytest.approx([2 / np.sqrt(20), 5 / np.sqrt(20)], rel=0.1)  # doubt counts as 4 samples


def test_intervals_hold_the_truth():
    """Of 400 fits of 60 samples with unit noise, 95 % of the intervals do: within 4 deviations."""
    fit, truth = Fit("f", ("a", "b")), np.array([0.7, -1.3])
    prior, inside = Prior((100, 100), (0, 0), 0.01, 1.0), []
    for _ in range(400):
        a = RNG.normal(size=(60, 2))
        solution = fit.solved(states(fit, a, a @ truth + RNG.normal(size=60)), prior)
        inside += [abs(float(s) - t) < 1.96 * float(d) for (s, d), t in zip(solution, truth, strict=True)]
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 800))


def test_without_data_a_size_is_its_reference_with_the_deviation_of_its_prior():
    """Exactly, as there is nothing else."""
    fit = Fit("f", ("a", "b"))
    empty = SimpleNamespace(**dict.fromkeys(fit.states, 0.0))
    found = list(fit.solved(empty, Prior((0.5, 2.0), (1.0, -3.0), 0.1, 0.1)))
    assert [float(v) for pair in found for v in pair] == pytest.approx([1.0, 0.5, -3.0, 2.0])


def test_a_prior_weighs_as_much_as_the_scatter_of_the_data_allows():
    """As by Bayes: 400 samples of noise 3, whose least is 0.1, and a prior of 0.2, which weighs half as much.

    To 10 %: the scatter is known to 1/sqrt(800), and in it counts how far the prior is off, here 8 %.
    """
    fit, y = Fit("f", ("a",)), RNG.normal(2.0, 3.0, size=400)
    sums = states(fit, np.ones((400, 1)), y)
    prior = Prior((0.2,), (0.0,), 0.1, 0.1)
    ((size, off),) = fit.solved(sums, prior, weighed=True)
    of_data, of_prior = 400 / 3.0**2, 1 / 0.2**2
    assert float(size) == pytest.approx(y.mean() * of_data / (of_data + of_prior), rel=0.1)
    assert float(off) == pytest.approx((of_data + of_prior) ** -0.5, rel=0.1)
    ((alone, _),) = fit.solved(sums, prior)
    assert float(alone) == pytest.approx(y.mean(), rel=1e-3)  # the least noise makes the prior worth nothing


@pytest.mark.parametrize("cylinders", [1, 2, 3])
def test_a_horizontal_force_counts_as_generalised_least_squares_do(cylinders):
    """Their products are C^T S^-1 C with the covariance S = I + (H/s)^2 h h^T, to rounding.

    One cylinder more does not count: its equation and its lever are zero.
    """
    force = 1500.0
    levers, columns = RNG.normal(size=cylinders), RNG.normal(size=(cylinders, 3))
    zero = dict.fromkeys(("torque", "blocked", "empty_torque", "empty_momentum"), 0.0)
    known = {"speeds": 1.0, "effort": {"empty": Effort(0.0, 0.0)}, "p": SimpleNamespace(weighing_lag=1.0)}
    sound = (*[1.0] * cylinders, 0.0)
    arms = zip((*levers, 7.0), sound, strict=True)
    axes = [SimpleNamespace(late_arm=h, sound=c, **zero, **known) for h, c in arms]
    load = Load(axes, SimpleNamespace(horizontal_square=force**2), None)
    rows = [([*c[:2]], c[2]) for c in (*columns, np.zeros(3))]
    calm = np.array([[float(v) for v in (*c, y)] for c, y in load.without_horizontal(rows)])
    covariance = np.eye(cylinders) + (force / NOISE) ** 2 * np.outer(levers, levers)
    expected = columns.T @ np.linalg.solve(covariance, columns)
    assert calm.T @ calm == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_sum_of_sizes_has_the_deviation_of_their_covariance():
    """Columns that are nearly equal leave their sum known and their difference not."""
    fit, a = Fit("f", ("a", "b")), RNG.normal(size=50)
    columns = np.column_stack([a, a + 1e-3 * RNG.normal(size=50)])
    solution = fit.solved(states(fit, columns, columns @ [1.0, 1.0]), Prior((10, 10), (0, 0), 0.1, 0.1))
    (total, of_total), (_, of_difference) = solution.along(1, 1), solution.along(1, -1)
    assert float(total) == pytest.approx(2, abs=0.01)
    assert float(of_difference) > 50 * float(of_total)


def test_states_of_a_finding():
    """1 above the limit by three deviations, 0 below, -1 if the deviation is too large or it is unusable."""
    cases = (2, 0.1, 1, 1), (1.2, 0.1, 1, 1), (2, 1.1, 1, 1), (2, 0.1, 1, 0)
    assert [float(judged(*case)) for case in cases] == [1, 0, -1, -1]


def test_a_volume_gathers_what_is_in_excess_and_is_never_negative():
    """With Euler's step of the diagnosis; what does not count is forgotten over 0.1 s."""
    volume = 2e-5
    assert volume + 0.01 * float(gathered(volume, 1e-3, 1)) == pytest.approx(3e-5)
    assert volume + 0.01 * float(gathered(volume, -1.0, 1)) == pytest.approx(0, abs=1e-20)
    assert volume + 0.01 * float(gathered(volume, 1e-3, 0)) == pytest.approx(1.8e-5)


def test_a_link_without_a_known_mass_has_a_tare_too():
    """A crane may state no mass of a link: what it weighs is uncertain by 1 kg, not by nothing."""
    tare = Tare(("boom",), ("link_mass",), (0.0,), (2e4,))
    sums = SimpleNamespace(**dict.fromkeys(tare.fit.states, 0.0))
    known = {f"{n}_reference": v for n, v in tare.references.items()}
    told = tare.told(sums, SimpleNamespace(**known))
    sizes = {n: float(ca.evalf(ca.SX(size))) for n, (size, _, _) in told.items()}
    off = float(ca.evalf(ca.SX(told["link_mass_off"][1])))
    healthy = {"link_mass_off": 0.0, "boom_dry_friction": 0.0, "boom_damping": 2e4, "boom_zero_force": 0.0}
    assert sizes == pytest.approx(healthy)
    assert 1.0 <= off < 10.0
