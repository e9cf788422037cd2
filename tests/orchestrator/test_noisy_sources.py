"""Sources with noise, and discrete ones: their inputs divide no steps, and get their values all the same."""

import numpy as np
import pytest
from kit.any_fmu.edit import edited

from orchestrator import Coupling, assemble, run

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
