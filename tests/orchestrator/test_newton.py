"""Newton's method for algebraic loops, seen from an FMU: where it is evaluated, when it is differentiated."""

from types import SimpleNamespace

import numpy as np
import pytest
from kit.mistakes import problem

from orchestrator.engine.algebraic_loop import solver
from orchestrator.ssp.dependencies import DependencyCycle
from orchestrator.ssp.system import Connection, Port


class Looped:
    """An FMU whose outputs y = g(u) feed its inputs, each the one of its number.

    visited      the inputs at which its outputs were read
    directions   along which it was differentiated
    """

    def __init__(self, g, u=(0.0,), slope=None, nominal=None, passes=0):
        """slope: the Jacobian that it gives at u; nominal: values of its inputs.

        passes: how often values are copied, because it does not declare what depends on what; 0: it does
        """
        self.g, self.u, self.slope = g, np.array(u, float), slope
        self.visited, self.directions, self.log = [], [], SimpleNamespace(time=0.0)
        kinds = [SimpleNamespace(function_type="Real", nominal=n) for n in nominal or self.u * 0]
        names = [(f"u{k}", f"y{k}") for k in range(len(kinds))]
        both = {name: kind for pair, kind in zip(names, kinds, strict=True) for name in pair}
        self.interface = SimpleNamespace(variables=both, directional_derivatives=slope is not None)
        wires = tuple(Connection(Port("p", y), Port("p", u)) for u, y in names)
        cycle = DependencyCycle(wires, not passes, rounds=1, discrete=None, passes=passes, text="loop")
        self.solve = solver({"p": self}, cycle)

    def reader(self, names, into):
        if names[0] == "u0":
            return lambda: np.copyto(into, self.u)

        def read():
            self.visited.append(tuple(self.u))
            into[:] = self.g(*self.u)

        return read

    def writer(self, _, values):
        return lambda: np.copyto(self.u, values)

    def directional_derivative(self, _outputs, _inputs, seed, into):
        def differentiate():
            self.directions.append(tuple(seed))
            into[:] = np.atleast_2d(self.slope(*self.u)) @ seed

        return differentiate


def constant(nominal=None):
    """y = value, whatever u is, with its slope 0."""
    p = Looped(lambda _: p.value, slope=lambda _: 0.0, nominal=nominal and [nominal])
    p.value = 0.0
    return p


def count(values):
    """How many values a call of `solve` adds."""
    before = len(values)
    return lambda: len(values) - before


# ---- what is solved


@pytest.mark.parametrize(("nominal", "history"), [(None, []), (1e2, []), (None, [1e2]), (1.0, [-1, -1e2])])
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_residual_of_1e_10_of_the_magnitude_is_a_solution(nominal, history, share):
    """The magnitude of an input is its nominal value or the largest until now; below it nothing moves."""
    p = constant(nominal)
    for value in [*history, 1.0]:
        p.value = value
        p.solve()
        assert p.u[0] == value  # a linear loop, whose slope is 0
    change = share * 1e-10 * (100.0 if history or nominal == 100.0 else 1.0)
    p.value = 1.0 + change
    p.solve()
    # rounding: differences of numbers near 1 are exact to 1e-16 of them
    assert p.u[0] == pytest.approx(1.0 if share < 1 else 1.0 + change, abs=1e-15)


@pytest.mark.parametrize("beside", [0.0, 1e6])
@pytest.mark.parametrize(("share", "solved"), [(0.99, True), (1.01, False)])
def test_a_step_is_halved_nine_times_at_most(share, solved, beside):
    """r = -1 + 2 u + c u^2 / 4 at u = 0: the full step to 1/2 leaves c/16, one of f = 2^-9 less than the
    residual before if f + c f^2 / 16 < 2. With a larger c the direction is taken to be wrong.

    An input of another magnitude, for which the full step is right, does not decide; nor what it was before.
    """
    f = 2.0**-9
    c = share * 16 * (2 - f) / f**2
    p = Looped(lambda u, _: (-u, 1.0), (0.0, 0.0), lambda u, _: np.diag([-1 - c * u / 2, 0.0]), [1e-6, 1e-6])
    p.solve()
    p.g = lambda u, _: (1 - u - c * u**2 / 4, beside)
    if solved:
        p.solve()
        # of the root of the parabola, whose residual is 1e-10 of 1, its magnitude, and whose slope is large
        assert p.u == pytest.approx([(np.sqrt(4 + c) - 2) / (c / 2), beside], rel=1e-6)
    else:
        problem(p.solve, r"no solution at t = 0 s: p\.u0 is set to 0 and would become 1")


@pytest.mark.parametrize(("share", "solved"), [(0.99, True), (1.01, False)])
def test_after_twenty_steps_a_residual_of_1e_6_is_a_solution(share, solved):
    """Each step leaves a share q of the residual, because the FMU's slope is wrong: q^20 is near 1e-6."""
    p = constant()
    p.solve()  # here the slope is right: it is not replaced by differences
    q = share * 1e-6 ** (1 / 20)
    p.slope, p.value, jacobians = lambda _: -q / (1 - q), 1.0, count(p.directions)
    if solved:
        p.solve()
        assert p.u[0] == pytest.approx(1.0 - q**20, rel=1e-12)  # rounding
    else:
        problem(p.solve, r"no solution .*a residual of -1\.22e-06")  # 1.01^20 = 1.22
    assert jacobians() == 20


@pytest.mark.parametrize("start", [0.0, 1.0])
@pytest.mark.parametrize(("share", "solved"), [(0.99, True), (1.01, False)])
def test_a_jump_across_the_solution_is_one_up_to_1e_6(share, solved, start):
    """y jumps from u0 + k down to u0 - k: no step gets nearer than k."""
    u0 = 1000.0
    k = share * 1e-6 * u0
    p = Looped(lambda u: u0 + k if u < u0 else u0 - k, [start * u0], slope=lambda _: 0.0, nominal=[u0])
    if solved:
        p.solve()
        assert abs(p.u[0] - u0) <= k
    else:
        problem(p.solve, "no solution at t = 0 s")


# ---- when the Jacobian is made


@pytest.mark.parametrize(("share", "renewals"), [(0.99, 0), (1.01, 1)])
def test_the_jacobian_is_kept_while_a_step_leaves_a_thousandth(share, renewals):
    """A linear loop whose 1 - dy/du has changed by that share: what a step with the old one leaves."""
    slope, value = -1.0, 1.0
    p = Looped(lambda u: slope * u + value, slope=lambda _: slope)
    p.solve()
    jacobians = count(p.directions)
    slope, value = 1 - 2 * (1 - share * 1e-3), 2.0
    p.solve()
    assert p.u[0] == pytest.approx(value / (1 - slope), rel=1e-10)
    assert jacobians() == renewals


@pytest.mark.parametrize("kept", ["from before", "in the same solution"])
def test_a_kept_jacobian_that_does_not_reduce_the_residual_is_made_anew(kept):
    """The residual falls where it had risen; no part of a step in the old direction would reduce it."""
    rising, falling = (lambda _: 1.0), (lambda u: 2 * u - 1.0005)  # r = u - 1, 1.0005 - u
    if kept == "from before":
        p = Looped(rising, slope=lambda _: 0.0)
        p.solve()
        p.g, p.slope = falling, lambda _: 2.0
    else:  # it rises up to 1, where a step from 0 leads, and leaves 5e-4
        p = Looped(lambda u: rising(u) if u < 0.9 else falling(u), slope=lambda u: 0.0 if u < 0.9 else 2.0)
    jacobians = count(p.directions)
    p.solve()
    assert p.u[0] == pytest.approx(1.0005, rel=1e-10)  # the residual
    assert jacobians() == (1 if kept == "from before" else 3)  # one to compare with a difference


def test_an_infinite_output_is_no_solution():
    """Although it is equal to itself."""
    problem(Looped(lambda _: np.inf).solve, r"no solution at t = 0 s: p\.y0 is inf")


@pytest.mark.parametrize("magnitude", [1e-3, 1.0, 1e6])
def test_a_difference_moves_an_input_by_a_millionth_of_its_magnitude(magnitude):
    """The magnitude is that of the input itself, or its nominal value if that is larger."""
    for u, nominal in ((magnitude, None), (-magnitude, None), (magnitude / 7, [magnitude])):
        p = Looped(lambda x: x / 2 + magnitude, [u], nominal=nominal)
        p.solve()
        moves = sorted(abs(x - u) for (x,) in p.visited)
        smallest = next(move for move in moves if move)
        assert smallest == pytest.approx(1e-6 * magnitude, rel=1e-8)  # rounding of u, 1e-16 / 1e-6


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize(("share", "used"), [(0.99, True), (1.01, False)])
def test_derivatives_may_differ_from_differences_by_a_tenth(row, share, used):
    """Of the largest change of the same output by an input's magnitude, not of their own."""
    scales = np.array([1e4, 1e-2])
    slopes = np.array([[-1.0, 0.02], [0.4, -5.0]]) * scales[:, None] / scales
    wrong = slopes.copy()
    # the small one of the row, by a tenth of the large one
    wrong[row, 1 - row] += share * 0.1 * slopes[row, row] * scales[row] / scales[1 - row]
    p = Looped(lambda *u: scales + slopes @ u, [1e3, 1e-3], lambda *_: wrong, list(scales))
    p.solve()
    exact = np.linalg.solve(np.eye(2) - slopes, scales)
    np.testing.assert_allclose(p.u / scales, exact / scales, rtol=0, atol=1e-9)  # residual: 1e-10 of them
    assert (len(p.directions) > 2) == used  # two to compare


# ---- dependencies that are not declared


def test_values_that_do_not_depend_on_themselves_are_copied():
    """In a chain of two each copy makes one more right; nothing is differentiated after the start."""
    p = Looped(lambda a, b: (3.0 + 0 * b, 2.0 * a), [0.0, 0.0], lambda *_: np.eye(2), passes=2)
    p.solve()
    (first, second), start = p.visited[1:3], (0.0, 0.0)
    assert p.visited == [start, first, second, start, (3.0, 0.0), (3.0, 6.0)]
    assert {first, second} == {(1e-6, 0.0), (0.0, 1e-6)}  # differences: without a magnitude the unit decides
    p.solve()
    assert p.visited[6:] == [(3.0, 6.0)]
    assert p.directions == []


def test_a_loop_is_found_at_the_start_or_when_copies_do_not_settle():
    """Then it is solved from where it was, and from the beginning in later steps."""
    p = Looped(lambda a, b: (1.0 + 0 * a, 3 * b + 1), [0.0, 0.0], lambda *_: np.eye(2), passes=2)
    p.solve()
    assert p.u == pytest.approx([1.0, -0.5], rel=1e-10)  # the residual
    assert (1.0, 1.0) not in p.visited  # nothing was copied
    late = Looped(lambda _: 4.0, slope=lambda _: 0.0, passes=2)
    late.solve()
    late.g, seen = lambda u: 3 * u + 1, count(late.visited)
    late.solve()
    assert [x for (x,) in late.visited[-seen() :][:4]] == [4.0, 13.0, 40.0, 4.0]
    assert late.u[0] == pytest.approx(-0.5, rel=1e-10)
    late.g, seen = lambda u: 3 * u + 2, count(late.visited)
    late.solve()
    assert late.u[0] == pytest.approx(-1.0, rel=1e-10)
    assert seen() == 2
    assert p.directions == late.directions == []  # slopes of what is not declared are not believed
