"""The compiled model against solutions and derivatives in closed form."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from kit.mistakes import problem, table
from kit.toy import toy

from fmus.identification.refinement.compiled_model import CompiledModel, SegmentSolution, SimulationFailed
from fmus.parameters import Values

TOY = toy(
    "toy",  # a lag, and growth in proportion to an input; nothing but the integral depends on `idle`
    p={"delay": "s", "gain": "1", "growth": "1/s", "seed": "1", "scale": "1"},
    x={"lag": "1", "total": "s", "size": "1"},
    u={"idle": "1", "drive": "1"},
    y={"lag": "1", "total": "s", "square": "1"},
    f=lambda x, u, p: {
        "lag": (p.gain * u.drive - x.lag) / p.delay,
        "total": x.lag + u.idle,
        "size": p.growth * u.drive * x.size,
    },
    g=lambda x, u, p: {"lag": x.lag, "total": x.total, "square": p.scale * x.size**2 + u.drive * p.gain},
    initial=lambda _, u, p: {"lag": p.gain * u.drive, "size": p.seed * (1 + u.drive)},
    require=lambda x, *_: {"size stays below 100": 100 - x.size},
)
NUMBERS = Values(
    p={"delay": 0.3, "gain": 2.0, "growth": 0.7, "seed": 0.5, "scale": 1.5},
    u={"idle": 0.0, "drive": 0.0},
    x={"lag": 0.0, "total": 0.0, "size": 0.0},
)
FREE = ("seed", "scale", "delay", "growth", "gain")
TOLERANCE = 1e-9
TIME = np.concatenate([np.linspace(0.0, 0.2, 5), np.linspace(0.25, 2.0, 30)])  # not uniform
U0, SLOPE = 0.4, 0.6
DRIVE = U0 + SLOPE * TIME


def model(outputs: Sequence[str] = ("lag", "square"), tolerance: float = TOLERANCE) -> CompiledModel:
    """The toy with two of its outputs."""
    return CompiledModel(TOY, outputs, FREE, NUMBERS, tolerance)


@pytest.fixture
def whole() -> tuple[CompiledModel, np.ndarray, SegmentSolution]:
    """The toy, a state, and the solution from there over the whole time."""
    toy, x0 = model(), np.array([0.1, 0.8])
    return toy, x0, toy.segment(x0, toy.p0, TIME, DRIVE[:, None])


def solution(x: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Outputs for initial states (lag, size) and the parameters FREE; also for complex numbers."""
    _, scale, delay, growth, gain = p
    line = gain * (U0 + SLOPE * (TIME - delay))  # what a ramp makes of the lag after a while
    lag = line + (x[0] - line[0]) * np.exp(-TIME / delay)
    size = x[1] * np.exp(growth * (U0 * TIME + SLOPE * TIME**2 / 2))
    return np.column_stack([lag, scale * size**2 + gain * DRIVE])


def slope(x: np.ndarray, p: np.ndarray, direction: int) -> np.ndarray:
    """Derivative of the solution with respect to one of (x, p) by a complex step, exact to rounding."""
    both = np.concatenate([x, p]).astype(complex)
    both[direction] += 1e-30j
    return solution(both[:2], both[2:]).imag / 1e-30


def test_outputs_and_all_their_derivatives_are_those_of_the_closed_form(whole) -> None:
    """A lag and bilinear growth with a ramp, from any state: every sensitivity is right."""
    toy, x0, piece = whole
    found = np.concatenate([piece.y_x, piece.y_p], axis=2)
    # error of the solver at a tolerance of 1e-9; it adds up over 2 s, in which the square grows tenfold
    assert piece.y == pytest.approx(solution(x0, toy.p0), rel=1e-7, abs=1e-7)
    for j in range(7):
        expected = slope(x0, toy.p0, j)
        assert found[:, :, j] == pytest.approx(expected, rel=1e-6, abs=1e-6)
    lag = found[-1, 0]  # an output that is a state: its row at the end is that of the state
    assert np.array_equal(np.concatenate([piece.x_x[0], piece.x_p[0]]), lag)


def test_the_start_is_that_of_the_subsystem() -> None:
    """`initial` and its derivatives: the lag at rest, the size from its seed."""
    toy = model()
    x0, slopes = toy.start(toy.p0, np.array([U0]))
    p, each = NUMBERS.p, np.array(FREE)
    assert x0 == pytest.approx([p["gain"] * U0, p["seed"] * (1 + U0)], rel=1e-15)  # rounding
    expected = np.array([U0 * (each == "gain"), (1 + U0) * (each == "seed")])
    assert slopes == pytest.approx(expected, rel=1e-15)


def test_what_the_outputs_do_not_depend_on_is_left_out(whole) -> None:
    """Only states and inputs with an effect remain; parameters of the initial state have zero columns."""
    toy, _, piece = whole
    assert toy.states == ("lag", "size")
    assert toy.inputs == ("drive",)
    assert not piece.y_p[:, :, FREE.index("seed")].any()
    assert model(("total",)).states == ("lag", "total")
    assert model(("total",)).inputs == ("idle", "drive")


def test_without_derivatives_the_outputs_are_the_same(whole) -> None:
    """Sensitivities do not change the steps."""
    toy, x0, full = whole
    bare = toy.segment(x0, toy.p0, TIME, DRIVE[:, None], False)
    assert np.array_equal(full.y, bare.y)
    assert np.array_equal(full.x, bare.x)
    assert (full.steps, bare.y_p.size) == (bare.steps, 0)


def test_one_sample_is_the_state_itself() -> None:
    """A segment of one sample has no step, only the derivatives of the outputs."""
    toy, x0 = model(), np.array([0.1, 0.8])
    piece = toy.segment(x0, toy.p0, TIME[:1], DRIVE[:1, None])
    assert (piece.steps, piece.x.tolist(), piece.x_x.tolist()) == (0, x0.tolist(), np.eye(2).tolist())
    assert not piece.x_p.any()
    assert piece.y_x[0] == pytest.approx(np.diag([1, 2 * 1.5 * 0.8]))


def test_no_free_parameter() -> None:
    """Initial states can be the only unknowns."""
    toy, x0 = CompiledModel(TOY, ("square",), (), NUMBERS, TOLERANCE), np.array([0.8])
    piece = toy.segment(x0, toy.p0, TIME, DRIVE[:, None])
    expected = slope(np.array([0.1, 0.8]), model().p0, 1)[:, 1]
    assert piece.y_x[:, 0, 0] == pytest.approx(expected, rel=1e-6)  # the solver's error, as above
    assert piece.y_p.shape == (TIME.size, 1, 0)


def test_other_numbers_are_no_other_code() -> None:
    """Values of all parameters are arguments of one library, those of fixed parameters too."""
    numbers = replace(NUMBERS, p={**NUMBERS.p, "gain": 3.0})
    toy, other = (CompiledModel(TOY, ("lag",), ("delay",), n, TOLERANCE) for n in (NUMBERS, numbers))
    still = np.full((TIME.size, 1), U0)
    ends = [m.segment(np.zeros(1), m.p0, TIME, still).x[0] for m in (toy, other)]
    assert ends[1] == pytest.approx(1.5 * ends[0], rel=1e-6)  # the solver's error


def test_failure_tells_the_time_and_the_reason() -> None:
    """A violated requirement, a parameter that is not a number, a step that cannot be computed."""
    toy, x0 = model(), np.array([0.1, 30.0])
    drive = np.full((TIME.size, 1), 2.0)
    with pytest.raises(SimulationFailed, match="size stays below 100") as failed:
        toy.segment(x0, toy.p0, TIME, drive)
    reached = np.log(100 / 30) / (0.7 * 2.0)  # when the size is 100
    assert failed.value.time == TIME[np.searchsorted(TIME, reached)]
    for name, value in (("growth", np.nan), ("delay", 0.0)):
        bad = toy.p0.copy()
        bad[FREE.index(name)] = value
        with pytest.raises(SimulationFailed, match="not finite") as failed:
            toy.segment(x0, bad, TIME, drive)
        assert failed.value.time == 0.0


@table(__file__, "names", "outputs, free, message")
def test_names_are_checked(outputs: list[str], free: list[str], message: str) -> None:
    """An unknown name is refused with a message that lists the declared ones."""
    problem(lambda: CompiledModel(TOY, outputs, free, NUMBERS), message)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inputs": np.zeros((TIME.size, 2))}, r"inputs: expected shape \(35, 1\) \(drive\), got \(35, 2\)"),
        ({"x": np.ones(1)}, r"states: expected shape \(2,\) \(lag, size\), got \(1,\)"),
        ({"p": np.ones(4)}, r"parameters: expected shape \(5,\) \(seed, .*, got \(4,\)"),
        ({"time": TIME * 0}, "each later than the one before"),
    ],
)
def test_samples_are_checked(change: dict[str, np.ndarray], message: str) -> None:
    """Arrays of another shape, beyond which C would read, and times that do not increase are refused."""
    good = {"x": np.array([0.1, 0.8]), "p": model().p0, "time": TIME, "inputs": DRIVE[:, None]}
    problem(lambda: model().segment(*(good | change).values()), message)
