"""Content of the report for a refinement, a comparison and the quality of a recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.report import samples
from identification.report.samples import channel

from fmus.identification.refinement.problem import EstimationProblem, FreeParameter, MeasuredRun
from fmus.identification.refinement.refine import RefinementResult, advice
from fmus.identification.refinement.shooting import Iteration
from fmus.identification.refinement.statistics import SimulatedRun, Statistics, Whiteness
from fmus.identification.report.identification_page import CHECK, faults, refinement, warnings
from fmus.identification.report.prediction import compare
from fmus.machine.one_block import HARVESTER
from orchestrator.data.recording import Recording, Sensor

TIME = np.arange(0.0, 2.0, 0.005)
PRELOAD = "boom_stick.initial_preload"


def traces(name: str, error: float) -> SimulatedRun:
    """A run that is off by `error` of its range in the first output, and has no second one."""
    measured = np.column_stack([np.sin(np.pi * TIME), np.zeros_like(TIME)])
    compared = np.column_stack([np.ones_like(TIME), np.zeros_like(TIME)]).astype(bool)
    run = MeasuredRun(name, TIME, {}, measured, compared.astype(float), np.array([2.0, 1.0]))
    return SimulatedRun(run, measured + 2 * error)


def refined(**more) -> RefinementResult:
    """A synthetic result."""
    free = tuple(FreeParameter(n, 2.0, log=True) for n in ("valve_area", "boom_stick_initial_preload"))
    training = (traces("a", 0.03), traces("b", 0.04))
    outputs, runs = ("boom_angle", "swing_flow_a"), tuple(t.run for t in training)
    labels = {"boom_angle": "manipulator.boom_angle", "boom_stick_initial_preload": PRELOAD}
    problem = EstimationProblem(HARVESTER, outputs, free, runs, labels=labels)
    covariance = np.array([[0.04, 0.01], [0.01, 0.01]])
    quiet = Whiteness(np.nan, np.nan)
    given = {
        "problem": problem,
        "z": np.log([2.0, 3.0]),
        "reason": "converged",
        "history": (),
        "statistics": Statistics(covariance, covariance, covariance, 100, 10, 7.0),
        "unidentified": (f"{PRELOAD} and valve_area: not each",),
        "at_bound": (PRELOAD,),
        "whiteness": {
            "manipulator.boom_angle": Whiteness(0.01, 1.1),
            "swing_flow_a": quiet,
        },
        "training": training,
        "held_out": (traces("c", 0.05),),
        "model_error": np.zeros(2),
        "simulator": None,
    }
    return RefinementResult(**{**given, **more})


def test_a_refinement_has_the_names_of_the_report():
    """Names of parameters.toml, root mean square over the recordings, None if nothing was measured."""
    found = refinement(refined())
    angle, flow = found["fits"]
    assert angle["signal"] == "manipulator.boom_angle"
    # exact identity: rounding only
    assert angle["train"] == pytest.approx(np.sqrt((0.03**2 + 0.04**2) / 2))
    assert angle["test"] == pytest.approx(0.05)
    assert (angle["noise"], angle["memory"]) == (1.1, 0.01)
    assert [flow[name] for name in ("train", "test", "noise")] == [None] * 3
    assert found["names"] == ["valve_area", PRELOAD]
    assert found["correlation"][0, 1] == pytest.approx(0.5)
    assert found["unidentified"] == [f"{PRELOAD} and valve_area: not each."]
    assert found["remarks"] == [f"{PRELOAD} ended at its bound."]
    remark = refinement(refined(reason="40 iterations"))["remarks"][0]
    assert remark.startswith("The search did not converge: 40 iterations were not enough.")
    assert "--free" in remark  # what to do


def machine() -> Recording:
    """A boom that moves, with a flow meter that has a dead zone."""
    noise = 5e-6 * np.random.default_rng(0).standard_normal(TIME.size)
    flow = 3e-4 * np.sin(np.pi * TIME) + noise
    signals = {"manipulator.boom_angle": 0.1 * np.sin(np.pi * TIME), "boom_stick.boom_head_flow": flow}
    units = {"manipulator.boom_angle": "rad", "boom_stick.boom_head_flow": "m3/s"}
    sensors = {"boom_stick.boom_head_flow": Sensor("turbine", 5e-6, dead_zone=1e-4)}
    about = {"procedure": "machine", "use": "test", "kind": "simulation"}
    return Recording(TIME, signals, units, Path("a/b.csv"), sensors=sensors, **about)


def test_speeds_are_compared_through_one_filter_and_flows_outside_the_dead_zone():
    """Speeds, measured and predicted, are derivatives of angles; a flow in the dead zone has no residual."""
    recording = machine()
    unused = {"manipulator.boom_speed": np.full(TIME.size, 9.0)}  # the predicted output
    predicted = dict(recording.signals) | unused
    seen = compare(recording, predicted)
    speed = seen.measured["manipulator.boom_speed"]
    known = np.isfinite(speed)
    assert known.sum() == TIME.size - 20  # ten samples on each side, half of 0.1 s
    # the filter's cubic over 0.1 s: its error is far below 1 % of the amplitude
    np.testing.assert_allclose(speed[known], 0.1 * np.pi * np.cos(np.pi * TIME[known]), atol=3e-3)
    np.testing.assert_array_equal(speed, seen.predicted["manipulator.boom_speed"])
    assert seen.units["manipulator.boom_speed"] == "rad/s"

    residual = seen.residual()["boom_stick.boom_head_flow"]
    dead = np.abs(recording["boom_stick.boom_head_flow"]) <= 1e-4
    assert 0 < dead.sum() < dead.size
    np.testing.assert_array_equal(np.isnan(residual), dead)


def test_the_lines_for_a_terminal():
    """One line for each fault; one line for all dead zones, which are not faults, with the largest."""
    flow, asleep = channel("flow", "m3/s", dead=0.4), channel("other_flow", "m3/s", dead=1.0)  # never moved
    faulty = channel("pressure", "Pa", "1 sample clipped.")
    recordings = [
        samples.quality("a.csv", (flow, asleep), "The clock: late."),
        samples.quality("b.csv", (faulty, replace(flow, dead=0.25))),
    ]
    *reported, zones = faults(recordings)
    assert reported == ["a.csv: The clock: late.", "b.csv: pressure: 1 sample clipped."]
    assert "2 recordings, at most 40 % of the samples (a.csv: flow)" in zones
    assert list(faults([])) == []


# ------------------------------------------------- warnings at the top of the page and in the terminal


def test_advice_and_intervals_depend_on_the_information():
    """A scatter between nine segments is advised against; an interval over a factor 1000 is open."""
    loud = {"manipulator.boom_angle": Whiteness(1.0, 2.0)}
    for segments, count in ((9, 1), (10, 0)):
        some = Statistics(np.eye(2), np.eye(2), np.eye(2), 100, segments, 7.0)
        assert len(advice(refined(statistics=some, whiteness=loud))) == count
    # half the interval is 1.984 standard deviations, and the logarithm of 1000 is 6.91
    for sd, is_open in ((3.4, False), (3.6, True)):
        covariance = sd**2 * np.eye(2)
        (one, _) = refined(statistics=Statistics(*3 * [covariance], 100, 10, 7.0)).estimates()
        assert np.isinf(one.high) == is_open


def test_residuals_far_above_the_noise_are_a_warning():
    """The number, and the worst signals that are above their noise; a good fit has none."""
    assert warnings(refined(at_bound=(), history=(Iteration(0, 2.9, 0.1, {}),))) == []
    many = {f"s{k}": Whiteness(1.0, 3.1 + k) for k in range(5)}
    one = {"manipulator.boom_angle": many["s4"], "swing_flow_a": Whiteness(0.01, 1.1)}
    worst = "(s4 7.1 times, s3 6.1 times, s2 5.1 times)"
    for tests, named in ((many, worst), (one, "(manipulator.boom_angle 7.1 times)")):
        fit = refined(at_bound=(), history=(Iteration(0, 168.0, 0.1, {}),), whiteness=tests)
        told, check = warnings(fit)
        assert "residuals 168 times as large as the noise" in told
        assert named in told
        assert check == CHECK
    assert len(warnings(refined(at_bound=(), history=(Iteration(0, 3.1, 0.1, {}),), whiteness=one))) == 2


def test_warnings_have_the_names_of_the_report():
    """Search, bound and poor signal, then the advice; of a failed simulation the signal without a value."""
    poor = refined(reason="40 iterations", training=(traces("a", 0.03), traces("b", 0.4)))
    search, bound, fit, check = warnings(poor)
    assert "did not converge: 40 iterations" in search
    assert PRELOAD in bound
    # root mean square of 3 % and 40 % over the same range
    assert "manipulator.boom_angle 28 %" in fit
    assert "flow" not in fit  # it was never measured
    assert check == CHECK
    *_, fit, _ = warnings(refined(at_bound=(), training=(traces("a", np.nan),)))
    assert "boom_angle (could not be simulated)" in fit
