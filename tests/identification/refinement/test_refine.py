"""Joint refinement of a known model: convergence, bounds, condensing, what the result does not depend on."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from identification.refinement.oscillator import INVERTED, NOISE, TRUTH, problem, recording, run, upright
from kit.mistakes import problem as problem_of

from benchmarks.black_box import BlackBox
from fmus.identification.refinement import shooting
from fmus.identification.refinement.refine import compiled, refine
from fmus.identification.refinement.shooting import Iteration, condense, triangular


def distance(found) -> float:
    """Square of the distance from the truth: chi square of three degrees of freedom, below 21 in 99.99 %."""
    away = found.z - np.log([TRUTH[name] for name in found.problem.names])
    return away @ np.linalg.solve(found.statistics.covariance, away)


def test_steps_shrink_quadratically_without_noise() -> None:
    """If residuals vanish at the optimum, each error is of the order of the square of the one before."""
    task = problem(run(recording(noise=0.0)))
    seen: list[Iteration] = []
    found = refine(task, compiled(task, 1e-10), horizon=np.inf, tolerance=1e-7, progress=seen.append)
    error = [max(abs(np.log(p.parameters[n] / TRUTH[n])) for n in task.names) for p in seen]
    late = [e for e in error if e < 0.1]
    assert found.converged
    # 2e-6: the weak prior of the start pulls with 1e-5 of the weight of the data (30 samples that are
    # correlated count as one), from 1 cm away
    assert error[-1] < 2e-6
    # 10: the constant of the quadratic, stiffness enters as a frequency over ten periods
    assert all(after < 10 * before**2 + 2e-6 for before, after in pairwise(late))


@pytest.mark.parametrize("off", [0.7, 1.3])
def test_segments_converge_where_one_shot_does_not(off: float) -> None:
    """An inverted pendulum, stabilised during the recording, falls in a simulation of the whole run."""
    task = replace(problem(run(upright(), INVERTED), off=off), sub=INVERTED)
    whole = refine(task, segment=np.inf, horizon=np.inf)
    cut = refine(task, segment=1.0, horizon=np.inf)
    assert not whole.converged
    assert cut.converged
    assert distance(cut) < 21
    # the sensors explain what is left: 801 samples, three standard deviations of a root mean square
    assert cut.history[-1].residual == pytest.approx(1, abs=3 / np.sqrt(2 * 801))


def test_result_does_not_depend_on_how_the_recording_is_cut() -> None:
    """Continuous segments have the criterion of a single simulation: same optimum, same covariance."""
    task = problem(run(recording()))
    one, many = (refine(task, segment=s, tolerance=1e-4) for s in (np.inf, 0.7))
    sd = one.statistics.sd(False)
    # steps end at 1e-4 standard deviations
    np.testing.assert_allclose(many.z, one.z, atol=float(1e-3 * sd.min()))
    np.testing.assert_allclose(many.statistics.covariance, one.statistics.covariance, rtol=1e-3)


def test_bounds_are_respected() -> None:
    """A parameter whose optimum is outside its bound stays at it and is reported, and the others adapt."""
    task = problem(run(recording()))
    damped = replace(task.free[1], low=0.4, value=0.5)
    found = refine(replace(task, free=(task.free[0], damped, task.free[2])))
    assert found.converged
    assert found.at_bound == ("damping",)
    estimate = found.estimates()[1]
    assert [found.values["damping"], estimate.low] == pytest.approx([0.4] * 2, rel=1e-9)  # the bound itself
    assert "at its bound" in estimate.note


def test_masked_samples_have_no_influence() -> None:
    """Values with weight zero have no effect: the result is bit-identical."""
    clean = run(recording())
    masked = (np.arange(len(clean.time)) >= 100) & (np.arange(len(clean.time)) < 130)
    weight = np.where(masked[:, None], 0.0, clean.weight)
    # a start at such a sample is guessed from the simulation, with both
    states = {name: np.where(weight[:, 0] > 0, x, np.nan) for name, x in clean.measured_states.items()}
    one = replace(clean, weight=weight, measured_states=states)
    other = replace(one, measured=np.where(masked[:, None], 1e6, clean.measured))
    assert (refine(problem(one)).z == refine(problem(other)).z).all()


def test_gaps_clipped_and_dead_samples_get_no_weight() -> None:
    """Gaps, clipped samples, and samples in and next to the dead zone have weight zero."""
    read = recording(dead_zone=3 * NOISE)
    position = read.signals["position"].copy()
    position[300] = np.nan
    weight = run(replace(read, signals={**read.signals, "position": position})).weight[:, 0]
    dead = np.abs(position) <= 3 * NOISE
    assert weight[300] == 0
    assert (weight[dead] == 0).all()
    assert (weight[1:][dead[:-1]] == 0).all()
    assert weight.max() == pytest.approx(1 / NOISE)


def test_threads_and_order_of_recordings_do_not_matter(monkeypatch) -> None:
    """Results are bit-identical for one and two threads, and equal to rounding in another order."""
    runs = [run(recording(seed)) for seed in range(3)]
    one, turned = (refine(problem(*ordered)) for ordered in (runs, runs[::-1]))
    monkeypatch.setattr(shooting, "THREADS", 1)
    assert (refine(problem(*runs)).z == one.z).all()
    # rounding, in another order; 1e-6 standard deviations are far below what a search resolves
    np.testing.assert_allclose(turned.z, one.z, atol=float(1e-6 * one.statistics.sd(False).min()))


def test_a_black_box_leads_to_the_same_optimum() -> None:
    """Finite differences of whole simulations, whose states cannot be set."""
    task = problem(run(recording()))
    exact = compiled(task, 1e-9)

    def simulated(p, time, u):
        return exact.segment(np.zeros(2), p, time, u, False).y

    box = BlackBox(simulated, exact.inputs, exact.outputs, exact.free, exact.p0)
    one = refine(task, exact, tolerance=1e-3)
    two = refine(task, box, tolerance=1e-3, segment=np.inf, horizon=np.inf)
    # the box starts from exactly zero, the other from an estimate: about half a standard deviation
    assert np.max(np.abs(one.z - two.z) / one.statistics.sd(False)) < 1


@pytest.mark.parametrize("horizon", [0.5, np.inf])
def test_interrupt_keeps_the_best_so_far(horizon: float) -> None:
    """Ctrl-C ends either search; the result is the best iterate, and its reason is the interrupt."""

    def stop(progress: Iteration) -> None:
        if progress.iteration == 1:
            raise KeyboardInterrupt

    task = problem(run(recording()))
    found = refine(task, horizon=horizon, progress=stop)
    assert (found.converged, found.reason, len(found.history)) == (False, "interrupted", 2)
    assert found.values == pytest.approx(dict(found.history[-1].parameters))


def test_errors_of_the_user_are_messages_of_one_line() -> None:
    """Such as an unknown parameter, no noise, no usable sample, a value outside its bounds: one line each."""
    one, bare = run(recording()), replace(recording(), sensors={})
    dead = run(recording(dead_zone=1e3))
    for call, message in (
        (lambda: problem(one, priors={"friction": (1.0, None)}), "oscillator: friction is not a parameter"),
        (
            lambda: problem(one, priors={"damping": (4.0, None)}),
            "damping: expected an initial value from 0 to 3 1/s .*, got 4",
        ),
        (lambda: run(bare), "position: expected a sensor with noise or resolution"),
        (lambda: refine(problem()), "expected at least one recording to fit"),
        (lambda: refine(problem(dead)), "oscillator_0: expected outputs with usable samples, got only"),
    ):
        assert re.search(message, problem_of(call))


def test_a_recording_may_begin_in_motion() -> None:
    """An initial speed that is not zero is not forced to zero, and the parameters stay right."""
    moving = run(recording().window(2.5, 12.0))
    found = refine(problem(moving))
    assert (run(recording()).at_rest, moving.at_rest) == (("speed",), ())
    assert found.converged
    assert distance(found) < 21
    assert distance(refine(problem(replace(moving, at_rest=("speed",))))) > 21


# ---- the condensed problem agrees with the full one, solved densely with its constraints

NX, FREE, SEGMENTS, ROWS = 3, 2, 4, 40


def test_the_step_is_that_of_the_whole_system() -> None:
    """Least squares over all unknowns, with multipliers for continuity, gives the same step."""
    rng = np.random.default_rng(0)
    jacobians = rng.standard_normal((SEGMENTS, ROWS, NX + FREE))
    residuals = rng.standard_normal((SEGMENTS, ROWS))
    ends = rng.standard_normal((SEGMENTS, NX, NX + FREE))
    gaps = rng.standard_normal((SEGMENTS - 1, NX))
    prior = np.hstack([np.eye(NX), np.zeros((NX, FREE)), rng.standard_normal((NX, 1))])
    rows = [triangular(np.column_stack(both)) for both in zip(jacobians, residuals, strict=True)]
    run = condense(rows, [np.column_stack(both) for both in zip(ends[:-1], gaps, strict=True)], prior)
    dz = np.linalg.lstsq(run.bottom[:, :-1], -run.bottom[:, -1], rcond=None)[0]

    size, states = SEGMENTS * NX + FREE, SEGMENTS * NX
    rows, right = np.zeros((SEGMENTS * ROWS + NX, size)), np.append(residuals.ravel(), prior[:, -1])
    closed = np.zeros((gaps.size, size))
    for i in range(SEGMENTS):
        own, here = slice(i * NX, (i + 1) * NX), slice(i * ROWS, (i + 1) * ROWS)
        rows[here, own], rows[here, states:] = jacobians[i, :, :NX], jacobians[i, :, NX:]
        if i < SEGMENTS - 1:
            closed[own, own], closed[own, states:] = ends[i, :, :NX], ends[i, :, NX:]
            closed[own, (i + 1) * NX : (i + 2) * NX] = -np.eye(NX)
    rows[-NX:, :NX] = np.eye(NX)
    whole = np.block([[rows.T @ rows, closed.T], [closed, np.zeros((gaps.size, gaps.size))]])
    step = np.linalg.solve(whole, -np.append(rows.T @ right, gaps.ravel()))[:size]
    # rounding, through normal equations of a condition below 1e4
    np.testing.assert_allclose(dz, step[states:], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(run.states(dz).ravel(), step[:states], rtol=1e-9, atol=1e-10)
