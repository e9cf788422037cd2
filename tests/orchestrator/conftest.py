"""Fixtures: small FMUs, and the two-mass oscillator made of two of them."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from kit.any_fmu.description import packed
from kit.any_fmu.models import HIGHEST, RATES, Workshop, oscillation, oscillator_of, telling
from kit.any_fmu.outcome import Outcome, compare, once
from numpy.typing import NDArray

from orchestrator import Coupling, Result, System, assemble
from orchestrator.base.files import Location
from orchestrator.fmi.cosimulation import CoSimulationFmu
from orchestrator.fmi.interface import read_interface


def pytest_make_parametrize_id(val: object) -> str | None:
    """Couplings in the names of cases."""
    return f"{val.text} {val.adaptive or ''}".strip() if isinstance(val, Coupling) else None


@pytest.fixture(scope="session")
def fmus3(fmus: Workshop) -> Workshop:
    """The same with FMI 3.0."""
    return fmus.other(3)


@pytest.fixture(params=["fmus", "fmus3"])
def each(request: pytest.FixtureRequest) -> Workshop:
    """FMUs of one version of FMI after the other."""
    workshop: Workshop = request.getfixturevalue(request.param)
    return workshop


@pytest.fixture(scope="session")
def oscillator(fmus: Workshop) -> System:
    """Two masses and three springs, undamped: a sends a force with feed-through, b its position."""
    return oscillator_of(fmus["mass_a"], fmus["mass_b"])


@pytest.fixture(scope="session")
def open_oscillator(fmus: Workshop) -> System:
    """Both masses have directional derivatives, and their inputs follow cubics."""
    return oscillator_of(telling(fmus, "mass_a"), telling(fmus, "mass_b"))


@pytest.fixture
def opened() -> Iterator[Callable[..., CoSimulationFmu]]:
    """opened(path, name): an instance of an FMU, not yet initialised; it is closed at the end."""
    with ExitStack() as instances:

        def make(path: Path | str, name: str = "it") -> CoSimulationFmu:
            fmu = Location(Path(path))
            return instances.enter_context(closing(CoSimulationFmu(name, read_interface(fmu), fmu)))

        yield make


@pytest.fixture
def started(opened: Callable[..., CoSimulationFmu]) -> Callable[..., CoSimulationFmu]:
    """started(path, **start): an instance that is ready to step from 0 to 10 s."""

    def make(path: Path | str, **start: object) -> CoSimulationFmu:
        slave = opened(path)
        slave.setup(0.0, 10.0, None)
        for name, value in start.items():
            slave.set(name, value)
        slave.enter()
        slave.exit()
        return slave

    return make


Oscillators = Callable[..., System]


@pytest.fixture(scope="session")
def oscillators(fmus: Workshop, fmus3: Workshop) -> Oscillators:
    """Makes oscillators whose FMUs follow their inputs by curves, lines, rates, or not at all: held."""

    def make(follow: str = "curves", fmi: int = 2, slopes: bool = True, **able: object) -> System:
        able |= {} if slopes else {"maxOutputDerivativeOrder": 0}
        workshop = {2: fmus, 3: fmus3}[fmi]
        name = "_".join([follow, *(f"{k}_{v}" for k, v in able.items())])
        more = {m: {"rates": [RATES[m]], "lines": [HIGHEST]}.get(follow, []) for m in RATES}
        interpolates = follow in ("curves", "lines")
        files = {
            m[-1]: workshop.make(m, f"{m}_{name}", interpolates=interpolates, able=able, also=more[m])
            for m in RATES
        }
        start = {"a.highest": 1, "b.highest": 1} if follow == "lines" else {}
        return assemble(files, ["a.force -> b.force", "b.x -> a.x2"], start)

    return cache(make)


@pytest.fixture(scope="session")
def moving(oscillators: Oscillators) -> System:
    """The oscillator made of FMUs whose inputs follow cubics, and which tell slopes and go back."""
    return oscillators()


@pytest.fixture(scope="session")
def bounce(fmus: Workshop) -> Callable[[bool], System]:
    """bounce(interpolates): a mass and a spring, 1 kg, 100 N/m, 100 m/s; force one way, velocity back."""

    def make(interpolates: bool) -> System:
        models = {"mass": "mass_b", "spring": "spring"}
        files = {n: fmus.make(m, f"{n}_{interpolates}", interpolates=interpolates) for n, m in models.items()}
        return assemble(files, ["spring.force -> mass.force", "mass.v -> spring.v"], {"mass.spring": 0.0})

    return cache(make)


@pytest.fixture(scope="session")
def exact() -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Exact positions of the oscillator's two masses at times from 0, shape (n, 2)."""
    return oscillation


@pytest.fixture(scope="session")
def worst(exact: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Callable[[Result], float]:
    """The largest error of the oscillator's first position, over the largest position."""

    def of(result: Result) -> float:
        truth = exact(result.trace.time)[:, 0]
        return float(np.abs(result.trace["a.x"] - truth).max() / np.abs(truth).max())

    return of


@pytest.fixture(scope="session")
def order() -> Callable[[Callable[[float], float], float], float]:
    """order(error, h): the order of convergence that the errors at the steps h and h/2 measure."""
    return lambda error, h: float(np.log2(error(h) / error(h / 2)))


@pytest.fixture
def zip_ssp(tmp_path: Path) -> Callable[..., Path]:
    """Writes an .ssp from the text of its .ssd and files by member name."""

    def write(ssd: str, files: dict[str, Path | str], name: str = "system.ssp") -> Path:
        parts = {n: f if isinstance(f, str) else f.read_bytes() for n, f in files.items()}
        return packed(tmp_path / name, {"SystemStructure.ssd": ssd, **parts})

    return write


@pytest.fixture
def both() -> Callable[..., Outcome]:
    """Runs a system whose FMUs C calls, and again through Python, and compares all that is left."""

    def run_both(system: System, master: object = "gauss-seidel", **options: object) -> Outcome:
        options = {"master": master, "step": 0.1, "stop": 1.0} | options
        fast = once(system, True, **options)
        slow = once(system, False, **options)
        compare(fast, slow)
        assert list(fast.result.trace.signals) == list(slow.result.trace.signals)
        a, b = fast.result.card, slow.result.card
        assert (a.passes, a.repeated, a.lengths, a.bonds) == (b.passes, b.repeated, b.lengths, b.bonds)
        return fast

    return run_both
