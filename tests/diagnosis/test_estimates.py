"""Least squares of the diagnosis: sizes are those of other libraries, and deviations are right."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from fmus.diagnosis import losses, unknowns
from fmus.diagnosis.estimates import Fit, States, judged
from fmus.diagnosis.weight import NOISE, without_horizontal

RNG = np.random.default_rng(5)


def fitted(columns, right, priors, least, rough, **options):
    """Least squares of equations, without fading, some samples after the last one."""
    empty = Fit(States(), "f", priors, least, rough)
    m = States(SimpleNamespace(**dict.fromkeys(empty.m.declared, 0.0)))
    fit = Fit(m, "f", priors, least, rough)
    fit.adds(1.0, [(list(c), y) for c, y in zip(columns, right, strict=True)], 1e9)
    sums = {n: float(rate) for n, rate in m.rates.items()}
    sums["f_spread"] = 0.0
    for _ in range(5):
        found = Fit(States(SimpleNamespace(**sums)), "f", priors, least, rough, **options)
        sums["f_spread"] = float(found.solution[2]) ** 0.5
    return found


def test_one_fault_is_no_sum_of_others():
    """Of a leak that two others together explain as well, it alone is told, with its own deviation."""
    for _ in range(50):
        a = np.abs(RNG.normal(3, 1, size=(40, 4)))
        a[:, 2] = a[:, 0] + a[:, 1] + 1e-3 * RNG.normal(size=40)
        a[:, 3] = RNG.normal(size=40)
        fit = fitted(a, 2 * a[:, 2] + RNG.normal(size=40), [(100, 0)] * 4, 1.0, 1.0, rare=3)
        *others, (size, off) = fit.sizes[:3]
        assert [float(s) for s, _ in others] == [0, 0]
        assert float(size) == pytest.approx(2, abs=4 * float(off))
        assert float(off) < 0.05  # 1/sqrt(40 (6^2 + 2)) = 0.026


def test_the_fault_that_is_told_explains_most():
    """With a free size: as by least squares of each fault alone with the free one, to rounding."""
    for _ in range(50):
        a = RNG.normal(size=(9, 4))
        y = a @ [3.0, 0.0, 0.0, -2.0] + RNG.normal(size=9)
        found = [float(s) for s, _ in fitted(a, y, [(1e6, 0)] * 4, 1e-4, 1.0, rare=3).sizes]
        each = [np.linalg.lstsq(a[:, [k, 3]], y, rcond=None) for k in range(3)]
        best = min((squares[0], k) for k, (s, squares, *_) in enumerate(each) if s[0] > 0)[1]
        (size, free), *_ = each[best]
        expected = [size if k == best else 0.0 for k in range(3)]
        assert found == pytest.approx([*expected, free], abs=1e-6)


def test_what_is_not_certain_is_no_size():
    """Noise alone makes no size that is rare, but for one in some hundred; it makes a free one."""
    found = []
    for _ in range(300):
        a = RNG.normal(size=(20, 2))
        fit = fitted(a, RNG.normal(size=20), [(100, 0)] * 2, 1.0, 1.0, rare=1)
        found.append([float(size) != 0 for size, _ in fit.sizes])
    # one side of 4.75 deviations: 1e-6
    assert np.mean(found, axis=0) == pytest.approx([0, 1], abs=0.015)


def test_equations_that_differ_more_are_a_change_not_noise():
    """The deviation grows with the residual up to `most`."""
    a, jump = np.ones((20, 1)), np.repeat([0.0, 10.0], 10)
    fits = [fitted(a, jump, [(100, 0)], 1.0, 1.0, most=most) for most in (2, 1e9)]
    offs = [float(fit.sizes[0][1]) for fit in fits]
    assert offs == pytest.approx([2 / np.sqrt(20), 5 / np.sqrt(20)], rel=0.1)  # doubt counts as 4 samples


def test_intervals_hold_the_truth():
    """Of 400 fits of 60 samples with unit noise, 95 % of the intervals do: within 4 deviations."""
    truth, inside = np.array([0.7, -1.3]), []
    for _ in range(400):
        a = RNG.normal(size=(60, 2))
        fit = fitted(a, a @ truth + RNG.normal(size=60), [(100, 0)] * 2, 0.01, 1.0)
        inside += [abs(float(s) - t) < 1.96 * float(d) for (s, d), t in zip(fit.sizes, truth, strict=True)]
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 800))


def test_without_data_a_size_is_its_reference_with_the_deviation_of_its_prior():
    """Exactly, as there is nothing else."""
    found = fitted([], [], [(0.5, 1.0), (2.0, -3.0)], 0.1, 0.1).sizes
    assert [float(v) for pair in found for v in pair] == pytest.approx([1.0, 0.5, -3.0, 2.0])


def test_a_prior_weighs_as_much_as_the_scatter_of_the_data_allows():
    """As by Bayes: 400 samples of noise 3, whose least is 0.1, and a prior of 0.2, which weighs half as much.

    To 10 %: the scatter is known to 1/sqrt(800), and in it counts how far the prior is off, here 8 %.
    """
    y, ones = RNG.normal(2.0, 3.0, size=400), np.ones((400, 1))
    ((size, off),) = fitted(ones, y, [(0.2, 0.0)], 0.1, 0.1, weighed=True).sizes
    of_data, of_prior = 400 / 3.0**2, 1 / 0.2**2
    assert float(size) == pytest.approx(y.mean() * of_data / (of_data + of_prior), rel=0.1)
    assert float(off) == pytest.approx((of_data + of_prior) ** -0.5, rel=0.1)
    ((alone, _),) = fitted(ones, y, [(0.2, 0.0)], 0.1, 0.1).sizes
    assert float(alone) == pytest.approx(y.mean(), rel=1e-3)  # the least noise makes the prior worth nothing


@pytest.mark.parametrize("cylinders", [1, 2, 3])
def test_a_horizontal_force_counts_as_generalised_least_squares_do(cylinders):
    """Their products are C^T S^-1 C with the covariance S = I + (H/s)^2 h h^T, to rounding.

    One cylinder more does not count: its equation and its lever are zero.
    """
    force = 1500.0
    levers, columns = RNG.normal(size=cylinders), RNG.normal(size=(cylinders, 3))
    table = ca.SX(ca.DM(np.vstack([columns, np.zeros(3)])))
    calm = without_horizontal(table, ca.SX(ca.DM([*levers, 0.0])), force**2)
    calm = np.array([[float(v) for v in (*c, y)] for c, y in calm])
    covariance = np.eye(cylinders) + (force / NOISE) ** 2 * np.outer(levers, levers)
    expected = columns.T @ np.linalg.solve(covariance, columns)
    assert calm.T @ calm == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_sum_of_sizes_has_the_deviation_of_their_covariance():
    """Columns that are nearly equal leave their sum known and their difference not."""
    a = RNG.normal(size=50)
    columns = np.column_stack([a, a + 1e-3 * RNG.normal(size=50)])
    fit = fitted(columns, columns @ [1.0, 1.0], [(10, 0)] * 2, 0.1, 0.1)
    (total, of_total), (_, of_difference) = fit.along(1, 1), fit.along(1, -1)
    assert float(total) == pytest.approx(2, abs=0.01)
    assert float(of_difference) > 50 * float(of_total)


def test_what_is_forgotten_of_one_size_takes_nothing_from_the_others():
    """What is known of the others alone is the Schur complement, which stays, to rounding; the last fades."""
    a, y = RNG.normal(size=(20, 3)), RNG.normal(size=20)
    whole = np.column_stack([a, y])
    squares = whole.T @ whole
    keys = [f"{i}_{j}" for j in range(3) for i in range(j + 1)]
    sums = {f"f_{k}": squares[int(k[0]), int(k[2])] for k in keys} | {"f_yy": squares[3, 3], "f_w": 20.0}
    m = States(SimpleNamespace(**sums | {f"f_{i}_y": squares[i, 3] for i in range(3)}))
    Fit(m, "f", [(1, 0)] * 3, 0.1, 0.1).adds(1.0, [([0.0] * 3, 0.0)], 1e12, changes=30.0)
    now = {n: getattr(m.x, n) + 0.01 * float(rate) for n, rate in m.rates.items()}
    after = np.empty((4, 4))
    for (i, j), k in {(int(k[0]), int(k[2])): k for k in keys}.items():
        after[i, j] = after[j, i] = now[f"f_{k}"]
    after[:3, 3] = after[3, :3] = [now[f"f_{i}_y"] for i in range(3)]
    after[3, 3] = now["f_yy"]
    kept = [0, 1, 3]
    alone = [n[np.ix_(kept, kept)] - np.outer(n[kept, 2], n[kept, 2]) / n[2, 2] for n in (squares, after)]
    assert alone[1] == pytest.approx(alone[0], rel=1e-6, abs=1e-6)
    assert after[2] == pytest.approx(0.7 * squares[2], rel=1e-6)


def test_states_of_a_finding():
    """1 above the limit by 4.75 deviations, 0 below, -1 if the deviation is too large or it is unusable."""
    cases = (2, 0.1, 1, 1), (1.2, 0.1, 1, 1), (2, 1.1, 1, 1), (2, 0.1, 1, 0)
    assert [float(judged(*case)) for case in cases] == [1, 0, -1, -1]


def test_a_cumulative_sum_gathers_what_is_in_excess_and_is_never_negative():
    """With Euler's step of the diagnosis; what does not count is forgotten over 0.1 s."""

    def after(excess, counts):
        m = States(SimpleNamespace(v=2e-5))
        return m.sum("v", "Oil", excess, counts, "m3", 0.1) + 0.01 * float(m.rates["v"])

    assert after(1e-3, 1) == pytest.approx(3e-5)
    assert after(-1.0, 1) == pytest.approx(0, abs=1e-20)
    assert after(1e-3, 0) == pytest.approx(1.8e-5)


@pytest.mark.parametrize("zeros", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("fills", [True, False])
def test_the_flow_of_one_side_bounds_that_of_the_other(fills, zeros):
    """By the law of orifices, q = a K sqrt(dP), of a chamber at 1 bar whose other side is at 60 bar.

    Without zeros exactly by `OUTLET`, 1.3; with zeros of 3 bar in each sensor, either way, on the safe side.
    """
    supply, tank, own, other, e, opening = 160e5, 2e5, 4e5, 60e5, 0.9, 1e-7
    into, out = (
        opening * np.sqrt(supply - np.array([own, other])),
        e * opening * np.sqrt(np.array([own, other]) - tank),
    )
    off = 3e5 * zeros
    p, u = (
        SimpleNamespace(zero_limit=3e5 * abs(zeros)),
        SimpleNamespace(supply_pressure=supply - off, tank_pressure=tank + off),
    )
    axis = SimpleNamespace(
        p=p, u=u, full=[1, 1], compensated=0, burst_told=0, pressures=[own + off, other - off]
    )
    axis.flows, axis.reference = [0.0, -out[1] if fills else into[1]], lambda _: e
    oil = [(float(fills), 0, 1.0, 1.0, 0), (float(not fills), 0, 1.0, 1.0, 0)]
    least, most = (float(v) for v in losses._seen(axis, 0, 1.0, oil))
    assert (least == 0, most == 1.0) == (not fills, fills)
    seen, exact = (into[0], least * 1.3) if fills else (most / 1.3, out[0])
    assert seen >= exact * (1 - 1e-9)
    if not zeros:
        assert seen == pytest.approx(exact, rel=1e-6)


def test_none_is_told_while_a_fault_would_have_been():
    """Of a sum that is more than 1, which goes up to 2 and fades by 1 in 5 s, but not below zero.

    It does not fade in a time that does not count. Rates are those of Euler's step of 10 ms.
    """

    def step(value, rate, fades=1):
        m = States(SimpleNamespace(v=value))
        return float(m.power("v", "Seen", rate, fades)), float(m.rates["v"])

    cases = {(0.9, 4.0): (0, 4.0), (1.1, 4.0): (1, 4.0), (1.99, 4.0): (1, 1.0), (2.0, 4.0): (1, 0.0)}
    cases |= {(2.0, -7.0): (1, -0.2), (1.5, 0.0): (1, -0.2), (1e-3, 0.0): (0, -0.1), (1.5, 0.0, 0): (1, 0.0)}
    for case, expected in cases.items():
        assert step(*case) == pytest.approx(expected, abs=1e-9), case


def test_a_latch_keeps_the_largest_size_until_the_reset():
    """One step up to a larger size, none down to a smaller one; to zero with the reset."""

    def after(size, reset):
        m = States(SimpleNamespace(v=2.0), reset)
        m.latch("v", m.state("v", "Size"), size)
        return 2.0 + 0.01 * float(m.rates["v"])

    assert [after(3.0, 0), after(1.0, 0), after(0.0, 1)] == pytest.approx([3.0, 2.0, 0.0])


def test_a_link_without_a_known_mass_has_a_tare_too(monkeypatch):
    """A crane may state no mass of a link: what it weighs is uncertain by 1 kg, not by nothing."""
    known = SimpleNamespace(p={"link_mass": 0.0, "boom_piston_damping": 2e4})
    monkeypatch.setattr(unknowns, "values", lambda _: known)
    monkeypatch.setattr(unknowns, "masses_of", lambda _: ["link_mass"])
    arm = SimpleNamespace(axes=[SimpleNamespace(name="boom", turns=False)])
    tare = unknowns.tare_of(arm, None)
    healthy = {"link_mass_off": 0.0, "boom_dry_friction": 0.0, "boom_damping": 2e4, "boom_zero_force": 0.0}
    assert {n: k.healthy for n, k in tare.items()} == healthy
    assert tare["link_mass_off"].prior == 1.0
