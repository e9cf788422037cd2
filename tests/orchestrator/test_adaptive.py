"""Steps of a run's own choice: errors, numbers, what they hit, what happens to bad ones, and their law."""

from ctypes import byref, c_double
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.any_fmu.edit import edited
from kit.shards import few

from orchestrator import Trace, assemble, run
from orchestrator.engine.c_library import engine_h, library
from orchestrator.ssp.coupling import Coupling


def adaptive(system, master, tolerance, stop=10.0, record_step=0.1, **more):
    """An adaptive run."""
    coupling = Coupling(master, adaptive=tolerance, **more)
    return run(system, master=coupling, stop=stop, record_step=record_step)


# ---- error and number of steps

FEW = {  # master, order, tolerance -> steps that it takes in 2 s, measured
    ("jacobi", 0, 1e-2): 5400,
    ("jacobi", 1, 1e-4): 4500,
    ("jacobi", 2, 1e-5): 2500,
    ("gauss-seidel", 0, 1e-2): 3000,
    ("gauss-seidel", 1, 1e-4): 2700,
    ("gauss-seidel", 2, 1e-5): 1700,
    ("gauss-seidel", 3, 1e-5): 660,
    ("hermite", 3, 1e-5): 660,  # 420 where it repeats
}
STUCK = {"canGetAndSetFMUstate": "false"}
# without repetition one order of each master: what differs then is the law alone, below
STANDS = [("jacobi", 1, 1e-4), ("gauss-seidel", 3, 1e-5), ("hermite", 3, 1e-5)]
CASES = [(settings, stuck) for stuck in (False, True) for settings in FEW]
QUICK = [(settings, stuck) for settings, stuck in CASES if not stuck or settings in STANDS]


@pytest.mark.parametrize(("settings", "stuck"), few(QUICK, CASES, shards.search), ids=str)
def test_no_master_collapses_to_the_smallest_step(oscillators, worst, settings, stuck):
    """Without damping no error decays; steps still keep the length that the tolerance allows."""
    master, order, tolerance = settings
    result = adaptive(oscillators(**(STUCK if stuck else {})), master, tolerance, stop=2.0, order=order)
    assert result.card.steps < 1.2 * FEW[settings]  # a step at the smallest length would be one of 2e7
    # inputs off by the tolerance all the time would add up; most are off by less (measured 0.02 to 0.4)
    assert worst(result) < tolerance
    assert ("not repeated: a, b cannot restore" in result.card.text()) == stuck


@pytest.mark.parametrize("master", ["gauss-seidel", "hermite"])
def test_the_error_goes_with_the_tolerance(moving, worst, master):
    """A hundredth of the tolerance, a hundredth of the error: within a factor of 3, over four decades."""
    results = [adaptive(moving, master, x, order=3) for x in (1e-3, 1e-5, 1e-7)]
    for a, b in pairwise(results):
        assert 100 / 3 < worst(a) / worst(b) < 100 * 3
        # of order 4: 100^(1/4) = 3.2 times the steps
        assert b.card.steps / a.card.steps == pytest.approx(100**0.25, rel=0.25)
    # measured 1.1e-6 by hermite; existing controllers need millions of steps or miss by 8e-5
    assert results[1].card.steps + results[1].card.repeated < 5000
    assert worst(results[1]) < 1e-5


def test_steps_grow_where_nothing_happens(fmus):
    """After a push the steps grow to the largest length."""
    files = {"sum": fmus.make("fails", "pushed", interpolates=True)}
    ramp = Trace(np.array([0.0, 0.01, 0.02, 8.0]), {"u": np.array([0.0, 1.0, 0.0, 0.0])})
    result = run(assemble(files), ramp, master=Coupling("hermite", adaptive=1e-4))
    assert result.trace["sum.y"][-1] == pytest.approx(0.01, rel=1e-12, abs=0)  # lines between corners: exact
    assert result.card.steps < 100
    assert result.card.lengths[1] == pytest.approx(0.1, rel=0.5)  # the largest allowed


# ---- what is hit

CORNERS = (0.0, 0.1234567, 0.3, 0.5000001, 0.7, 1.0 / 3.0 + 0.5, 1.0)


@pytest.fixture(scope="module")
def pushed(moving):
    """The oscillator whose first mass is driven by a scenario with corners at odd times."""
    time = np.array(sorted(CORNERS))
    return moving, Trace(time, {"a.x2": np.array([0.0, 1.0, 1.0, -2.0, 0.0, 0.5, 0.5])})


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel", "hermite"])
def test_output_times_and_corners_are_hit_to_the_last_bit(pushed, master):
    """Only the points start + n * step of the record step are recorded; without it all points."""
    system, scenario = pushed
    coupling = Coupling(master, 2, adaptive=1e-4)
    trace = run(system, scenario, master=coupling, start=0.05, stop=0.95, record_step=0.09).trace
    np.testing.assert_array_equal(trace.time, 0.05 + np.arange(11) * 0.09)
    time = run(system, scenario, master=coupling).trace.time
    assert set(CORNERS) <= set(time.tolist())
    assert (np.diff(time) > 0).all()


def test_a_corner_beside_an_output_time_makes_no_tiny_step(pushed):
    """3 * 0.1 is not 0.3: a step as short as a rounding error would spoil differences of values."""
    system, scenario = pushed
    assert 3 * 0.1 != 0.3
    result = run(system, scenario, master=Coupling("jacobi", 3, adaptive=1e-4), record_step=0.1)
    assert result.card.lengths[0] > 0.99e-7
    steps = np.arange(11) * 0.1
    np.testing.assert_array_equal(result.trace.time, steps)
    near = run(system, scenario, master=Coupling("hermite", passes=30, tolerance=1e-12), step=1e-4).trace
    # a hundred steps of error 1e-4 each, at most
    np.testing.assert_allclose(result.trace["b.x"], np.interp(steps, near.time, near["b.x"]), atol=1e-2)


# ---- what happens to bad steps

PUSH = Trace(np.array([0.0, 0.499, 0.501, 1.0]), {"a.u": np.array([0.0, 0.0, 50.0, 50.0])})


def test_bad_steps(fmus):
    """They are repeated, counted, not recorded; where an FMU cannot go back only the next step is shorter."""
    # an integrator fed by that of a push, which cannot be extrapolated; and where none can go back
    parts = (fmus.make("fails", f"jump_{len(a)}", interpolates=True, able=a) for a in ({}, STUCK))
    integrals = [assemble({"a": part, "b": part}, ["a.y -> b.u"]) for part in parts]
    master = Coupling("jacobi", adaptive=1e-3)
    # the first step that could not be taken back is a thousandth of the given one
    first = [run(s, PUSH, master=master, step=0.05, stop=0.2).trace.time[1] for s in integrals]
    assert first == pytest.approx([0.05, 5e-5], rel=1e-15)  # one product
    result, stuck = (run(s, PUSH, master=master) for s in integrals)
    assert result.card.repeated > 0
    assert f"{result.card.repeated} repeated" in result.card.text()
    assert len(result.trace.time) == result.card.steps + 1
    # held inputs are off by half the tolerance (of 25, the largest) in the mean, over half a second
    exact = 0.5 * 50 * 0.5**2
    assert result.trace["b.y"][-1] == pytest.approx(exact, abs=0.5 * 1e-3 * 25)
    assert stuck.card.repeated == 0
    steps = np.diff(stuck.trace.time)
    # a bad step makes the next one shorter, by the largest factor where the error is large
    assert (steps[1:] / steps[:-1]).min() < 0.5
    note = "adaptive steps with too large an error are not repeated: a, b cannot restore a saved state"
    assert note in stuck.card.notes


# ---- the law

SAFETY, SHRINK, GROW, REPEATED, NEARLY = 0.8, 0.2, 2.0, 0.9, 1 - 1e-9  # of native/step_size.c


class StepSize:
    """`StepSize` of the engine before its first step, and its functions."""

    def __init__(self, power=1, repeats=True, first=1e-3, largest=0.1):
        limits = {"smallest": 1e-7, "largest": largest}
        self.struct = engine_h().StepSize(h=first, power=power, repeats=repeats, **limits)

    @property
    def h(self):
        return self.struct.h

    def length(self, room):
        return library().step_size_next(byref(self.struct), c_double(room))

    def good(self, e, h):
        return bool(library().step_size_accepts(byref(self.struct), c_double(e), c_double(h)))


errors = st.floats(0.0, 1e6)
powers = st.integers(1, 5)


@given(errors, errors, powers, st.booleans())
def test_a_larger_error_never_makes_the_next_step_longer(one, other, power, repeats):
    """After equal previous steps, for accepted and for rejected steps."""
    small, large = sorted((one, other))
    sizes = StepSize(power, repeats), StepSize(power, repeats)
    for size, e in zip(sizes, (small, large), strict=True):
        size.good(0.5, 1e-3)
        size.good(e, 1e-3)
    assert sizes[0].h >= sizes[1].h


@given(st.lists(st.tuples(errors, st.floats(1e-6, 1.0)), max_size=30), powers, st.booleans())
def test_steps_stay_within_their_limits(history, power, repeats):
    """For any errors; the ratio of two successive steps has limits."""
    size = StepSize(power, repeats)
    for e, room in history:
        h = size.length(room)
        assert 0 < h <= room
        stands = size.good(e, h)
        assert stands == (e <= 1.0 or not repeats or h <= 1e-7)
        assert 1e-7 <= size.h <= 0.1
        if not stands:
            assert size.h <= max(REPEATED * h, 1e-7)
        assert size.h >= min(SHRINK * h, 0.1) * (1 - 1e-15)


@given(st.floats(1e-9, 10.0), st.floats(1e-6, 1.0))
def test_the_end_is_hit_without_a_short_last_step(room, step):
    """The step ends there, or the remaining time is at least as long as the step."""
    size = StepSize(first=step, largest=1.0)
    h = size.length(room)
    assert h == room or room - h >= h * (1 - 1e-15)
    # a step that misses its end by 1e-9, the rounding of a grid, would be halved for it, with twice the cost
    assert h <= max(step / NEARLY, room / 2)


def test_a_step_that_was_cut_does_not_shorten_the_next():
    """A step that is cut at an output time does not reset the control; a rejected step does."""
    for e, expected in ((0.5, 1e-2), (2.0, 1e-4)):
        size = StepSize(first=1e-2, repeats=False)
        assert size.length(1e-4) == 1e-4
        assert size.good(e, 1e-4)
        assert (size.h >= expected) if e < 1 else (size.h < expected)


@pytest.mark.parametrize("power", [1, 2, 3, 4])
def test_an_error_that_is_a_power_of_the_step_settles(power):
    """The step converges, without oscillation, to the one whose error is a safe fraction of the tolerance."""
    size, found = StepSize(power), []
    for _ in range(60):
        h = size.length(1e9)
        size.good((h / 5e-3) ** power, h)
        found.append(h)
    assert found[-1] == pytest.approx(SAFETY * 5e-3, rel=1e-3)  # converged: differences shrink by the law
    growth = np.array(found[1:]) / found[:-1]
    assert growth.max() <= GROW * (1 + 1e-15)
    assert growth.min() > 0.9  # the law answers to the growth of the error, too: once back by 7 %


def test_the_law_in_numbers():
    """Errors 0.5, 0.25, 2 and 0 at power 1: 0.8/0.5, then 3.2^0.3 2^0.4, 0.8/2, and the longest step."""
    size, h = StepSize(first=1e-2), 1e-2
    for e, ratio in ((0.5, 1.6), (0.25, 1.870497), (2.0, 0.4), (0.0, 2.0)):
        assert size.good(e, h) == (e <= 1)
        assert size.h == pytest.approx(ratio * h, rel=1e-6)  # the digits above
        h = size.h


@pytest.mark.parametrize("e", [float("nan"), float("inf")])
def test_what_is_no_number_is_an_error(e):
    """It is repeated as long as that is possible, with the shortest step that the law allows."""
    size = StepSize()
    assert not size.good(e, 1e-3)
    assert size.h == pytest.approx(SHRINK * 1e-3, rel=1e-15)
    assert StepSize(repeats=False).good(e, 1e-3)
    assert StepSize().good(e, 1e-7)  # at the smallest step errors are let pass


# ---- Sources with noise, and discrete ones: their inputs divide no steps, and get their values all the same

STEP, STEPS = 1e-3, 10
GUARDED = Coupling("gauss-seidel", guard=0.005)
NOISE = {"s.omega": 2e4}  # rad/s: three periods in a step, so the values at its ends look like noise
ANNOTATION = {  # FMI version -> its elements and their key, and what follows it
    2: ("VendorAnnotations", "Tool", "name", "<ModelVariables>"),
    3: ("Annotations", "Annotation", "type", "</fmiModelDescription>"),
}


def noisy(workshop):
    """The source whose description says that its output is noisy."""
    group, item, key, place = ANNOTATION[workshop.fmi]
    inside = "<Outputs><NoisyOutput output='y'/></Outputs>"
    added = f"<{group}><{item} {key}='harvester-cosim.outputs'>{inside}</{item}></{group}>"
    return edited(workshop["source"], workshop.folder / "noisy.fmu", (place, rf"{added}\g<0>"))


def fed(workshop, source, **more):
    """Noise, integrated: a run of ten steps."""
    system = assemble({"s": source, "d": workshop["drift"]}, ["s.y -> d.u"], NOISE)
    return run(system, stop=STEP * STEPS, **more)


def discrete(workshop):
    """The source with an output that holds its values."""
    return workshop.make("source", "discrete", changes={"y": {"steady": "discrete"}})


@pytest.mark.parametrize("kind", [noisy, discrete])
def test_no_step_is_divided(each, kind):
    """The run is that without a guard to the last bit; as a plain source, steps end where it is a curve."""
    found, bare = (fed(each, kind(each), step=STEP, master=m) for m in (GUARDED, Coupling("gauss-seidel")))
    assert (found.card.steps, found.card.repeated) == (STEPS, 0)
    assert found.trace == bare.trace
    plain = fed(each, each["source"], step=STEP, master=GUARDED)
    assert plain.card.steps > 10 * STEPS


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel", "hermite"])
def test_adaptive_steps_grow_beside_noise(each, master):
    """From 0.1 ms on each is twice as long as the one before: 0.1 (2^7 - 1) ms reach the end."""
    chosen = {"step": 1e-4, "master": Coupling(master, adaptive=1e-3)}
    assert fed(each, noisy(each), **chosen).card.steps <= 7
    assert fed(each, each["source"], **chosen).card.steps > 10 * STEPS


@pytest.mark.parametrize("kind", [noisy, discrete])
@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel", "hermite"])
def test_the_values_are_passed_on(each, kind, master):
    """The input is its source at each point; the integral is that of a line, or of the first value held."""
    trace = fed(each, kind(each), step=STEP, master=Coupling(master, guard=0.005)).trace
    y = trace["s.y"]
    assert np.ptp(y) > 1
    np.testing.assert_array_equal(trace["d.u"], y)
    used = y[:-1] if master == "jacobi" or kind is discrete else (y[:-1] + y[1:]) / 2
    if (kind, master) != (noisy, "hermite"):  # whose cubic has slopes from differences of noise
        # the same sums in another order: rounding
        np.testing.assert_allclose(np.diff(trace["d.y"]), STEP * used, atol=1e-15)
