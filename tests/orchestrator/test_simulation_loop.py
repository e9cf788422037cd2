"""The loop in C: FMUs that C calls and objects of Python give the same bits; no compiler; Ctrl-C; memory."""

import ctypes
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from unittest.mock import Mock

import numpy as np
import pytest
from kit import shards
from kit.any_fmu.models import RAMP
from kit.compile import library
from kit.fmu import in_new_process
from kit.mistakes import entry
from kit.needs import needs
from kit.plain_jacobi import plain_jacobi
from kit.shards import few, thinned

from orchestrator import Problem, Trace, assemble, run
from orchestrator.base import compiler
from orchestrator.engine import c_library, simulation_loop
from orchestrator.ssp.coupling import Coupling

STEPS = {"step": 1e-3, "stop": 1.0}  # a thousand


@pytest.fixture
def alike(both):
    """A run without an error, with FMUs called by C and by Python: all values are bit-identical."""

    def run_both(system, **options):
        outcome = both(system, **{"step": None, **options})
        assert outcome.error == ""
        return outcome.result

    return run_both


def test_it_is_what_a_plain_jacobi_does(oscillator):
    """An independent master of sixty lines gives bit-identical results."""
    names = ["a.x", "b.x", "a.force"]
    expected = plain_jacobi(oscillator, 1e-3, 1000, names, rounds=3)
    trace = run(oscillator, master="jacobi", **STEPS).trace
    for name in names:
        np.testing.assert_array_equal(trace[name], expected[name], err_msg=name)


def test_structures_are_laid_out_as_in_c(tmp_path):
    """Sizes of all structures in the header, and offsets of their last members."""
    h = c_library.engine_h()
    made = {n: t for n, t in vars(h).items() if isinstance(t, type) and issubclass(t, ctypes.Structure)}
    last = {name: kind._fields_[-1][0] for name, kind in made.items()}
    pairs = ", ".join(f"sizeof({name}), offsetof({name}, {last[name]})" for name in made)
    source, binary = tmp_path / "sizes.c", tmp_path / "sizes.so"
    source.write_text(f'#include <stddef.h>\n#include "engine.h"\nconst size_t sizes[] = {{{pairs}}};\n')
    binary.write_bytes(library("sizes", [source], included=[c_library.FOLDER / "engine.h"]))
    found = (ctypes.c_size_t * (2 * len(made))).in_dll(ctypes.CDLL(str(binary)), "sizes")
    expected = [n for name, k in made.items() for n in (ctypes.sizeof(k), getattr(k, last[name]).offset)]
    assert [*found] == expected
    assert len(made) > 15


KINDS = [("curves", 2, True), ("lines", 2, True), ("rates", 3, True), ("held", 3, True), ("curves", 2, False)]
COUPLINGS = [
    *(Coupling(master, n) for master in ("jacobi", "gauss-seidel") for n in range(4)),
    Coupling("hermite", guard=0, passes=1),
    Coupling("hermite", guard=0, passes=2, tolerance=1e-14),
    Coupling("hermite", guard=0),
    Coupling("hermite", guard=0, factors={"a": 3, "b": 2}),
    *(Coupling("jacobi", factors={"b": 7}), Coupling("gauss-seidel", 2, factors={"a": 2})),
]


# each coupling with one kind of input or two: what follows an input is one function for all of them
@pytest.mark.parametrize(("master", "kind"), thinned(4, COUPLINGS, KINDS))
def test_equal_steps(alike, oscillators, master, kind):
    """A thousand, with each kind of input interpolation, and without slopes of outputs."""
    result = alike(oscillators(*kind), master=master, **STEPS)
    assert result.card.steps == 1000
    assert np.ptp(result.trace["a.x"]) > 1


ADAPTIVE = [
    *(Coupling("jacobi", 2, adaptive=1e-5), Coupling("gauss-seidel", 1, adaptive=1e-4)),
    *(Coupling("hermite", adaptive=1e-6), Coupling("jacobi", adaptive=1e-3)),
    Coupling("hermite", adaptive=1e-6, factors={"b": 3}),
]


@pytest.mark.parametrize(
    ("master", "record_step", "able"),
    thinned(2, ADAPTIVE, [None, 0.03], [{}, {"canGetAndSetFMUstate": "false"}]),
)
def test_adaptive_steps(alike, oscillators, master, record_step, able):
    """Every step has the same length and error, and the same ones are repeated."""
    result = alike(oscillators(**able), master=master, stop=0.9, record_step=record_step)
    assert result.card.steps > 100
    assert (result.card.repeated > 0) == (not able)


def test_energy_of_bonds(alike, bounce):
    """The energy error of the coupling is summed in the same order."""
    fixed = alike(bounce(True), master=Coupling("gauss-seidel", 1), **STEPS)
    free = alike(bounce(True), master=Coupling("hermite", 1, adaptive=1e-4), stop=1.0)
    for result in (fixed, free):
        (bond,) = result.card.bonds
        assert bond.turnover > 0


MASTERS = [
    *(Coupling("jacobi"), Coupling("jacobi", 2), Coupling("gauss-seidel", 3), Coupling("hermite", guard=0)),
    Coupling("hermite", adaptive=1e-5),
]


@pytest.mark.parametrize(("master", "kind"), thinned(3, MASTERS, [("curves", 2), ("rates", 3), ("held", 3)]))
def test_a_scenario_leads(alike, oscillators, master, kind):
    """A driven input, with corners inside steps; before and after its table it is held."""
    led = Trace(np.array([0.1, 0.3504, 0.7, 0.9]), {"a.x2": np.array([0.0, 3.0, -1.0, 2.0])})
    options = {"stop": 1.0} if master.adaptive else STEPS
    result = alike(oscillators(*kind), scenario=led, master=master, **options)
    assert result.trace["a.x2"][-1] == 2.0


@pytest.mark.parametrize("master", MASTERS)
def test_wires_with_factors_and_sources_with_corners(alike, each, master):
    """Linear maps, chains of feed-through, and a ramp with corners."""
    files = {
        "ramp": each.make("source", "bending", also=RAMP),
        "g": each["gain"],
        "sum": each.make("fails", "added", interpolates=each.fmi == 2),
        "sum2": each["drift"],
    }
    wires = [("ramp.y", "g.u", 3.0, 0.5), "g.y -> sum.u", ("sum.y", "sum2.u", -2.0, 1.0)]
    system = assemble(files, wires, {"ramp.ramp": 2.0, "ramp.bend": 0.3303, "ramp.omega": 7.0})
    options = {"stop": 1.0, "record_step": 0.1} if master.adaptive else {"step": 1e-2, "stop": 1.0}
    assert abs(alike(system, master=master, **options).trace["sum2.y"][-1]) > 0.1


def test_chosen_signals_and_coarse_records(alike, oscillator):
    """The same rows of the same columns; more steps than fit into a block of the recorder or the monitor."""
    chosen = ["b.force", "a.mass", "a.x"]
    trace = alike(oscillator, step=1e-3, stop=2.5, record=chosen, record_step=7e-3).trace
    assert list(trace.signals) == chosen
    np.testing.assert_array_equal(trace["a.mass"], 1.0)
    assert len(trace.time) == 2500 // 7 + 2


@pytest.mark.parametrize("order", [0, 2])
def test_threads_give_the_same_bits(monkeypatch, oscillators, fmus, order):
    """Threads for the components of Jacobi do not change the results."""
    monkeypatch.setattr(simulation_loop, "CORES", 3)
    parts = oscillators()
    files = {name: part.source.path for name, part in parts.components.items()}
    files |= {"s": fmus["source"], "k": fmus.make("spring", "third", interpolates=True)}
    system = assemble(files, [*map(str, parts.connections), "b.v -> k.v"])
    results = []
    for saving in (np.inf, -1.0):
        monkeypatch.setattr(simulation_loop, "MIN_SAVING", saving)
        results.append(run(system, master=Coupling("jacobi", order), **STEPS))
    assert results[1].trace == results[0].trace


@shards.platforms
@pytest.mark.parametrize("target", ["x86_64-windows-gnu", "aarch64-macos"])
def test_the_code_compiles_for_other_systems(tmp_path, target):
    """Without a warning; headers of other systems have other names."""
    flags = [flag for flag in compiler.C_FLAGS if flag != "-shared"]
    for source in c_library.FOLDER.glob("*.c"):
        command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *flags, "-o", tmp_path / "a.o"]
        done = subprocess.run(
            [*command, "-c", source.name], cwd=c_library.FOLDER, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr


# ---- without a compiler


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """An empty cache of compiled libraries; what is compiled are two of the files."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def two_files(platform):
        name, code, arguments = compiler.recipe("engine", c_library.FOLDER, platform)
        others = {file for file in code if file.endswith(".c")} - {"coupling_input.c", "step_size.c"}
        return name, code, [argument for argument in arguments if argument not in others]

    monkeypatch.setattr(c_library, "recipe", two_files)
    c_library.library.cache_clear()
    yield
    c_library.library.cache_clear()


INSTALL = 'the package ziglang is not installed; install with: pip install "harvester-cosim[build]"'
NO_FLAG = (compiler, "C_FLAGS", (*compiler.C_FLAGS, "-fno-such-flag"), "fno-such-flag")
NO_COMPILER = (compiler, "version", Mock(side_effect=PackageNotFoundError), INSTALL)


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize(("module", "name", "value", "reason"), [NO_FLAG, NO_COMPILER])
def test_a_missing_compiler_is_one_line(monkeypatch, oscillator, module, name, value, reason):
    """The message has the reason; without a compiler also what to install."""
    monkeypatch.setattr(module, name, value)
    with pytest.raises(Problem, match=r"^the engine is not compiled: .*\Z") as told:
        run(oscillator, step=1e-2, stop=0.5, isolate=False)
    assert type(told.value) is Problem  # no run was begun
    assert reason in str(told.value)


# ---- long runs, in a process of their own

START = entry(__file__, "start")
LONG = entry(__file__, "long")


def interrupted(*arguments, talker=(), steps=1000):
    """What a run says that was interrupted after more than these steps.

    Half a second after the start it has made many; where much else is done it gets more time to begin.
    """
    for delay in (0.5, 2.0, 8.0, 32.0):
        said = in_new_process(START + LONG, *arguments, delay, *talker).split()
        if int(said[2]) > steps:
            break
    return said


# in each process a second passes before the interrupt; the others differ in what C does between two checks
INTERRUPTS = [("jacobi", 1, 1.0), ("jacobi", 1, -1.0), ("hermite", 1, 1.0), ("jacobi", 0, 1.0)]


@pytest.mark.parametrize(("master", "in_c", "worth"), few(INTERRUPTS[:1], INTERRUPTS, shards.faults))
def test_ctrl_c_ends_a_run_at_once_and_keeps_the_record(moving, master, in_c, worth):
    """With and without threads, and FMUs that Python calls; C checks for an interrupt every 0.1 s."""
    assert simulation_loop.ADVANCE_TIME <= 0.1
    files = [part.source.path for part in moving.components.values()]
    rows, reached, steps, complete = interrupted(*files, master, in_c, worth)
    assert int(steps) > 1000
    assert int(rows) == int(float(reached) - 1e-9) + 2  # a row for each second and the last point
    assert float(reached) == pytest.approx(1e-3 * int(steps), rel=1e-9)  # rounding of one product
    assert complete == "False"


@pytest.mark.parametrize("in_c", [1, pytest.param(0, marks=shards.faults)])
def test_ctrl_c_is_not_lost_in_the_messages_of_an_fmu(fmus, moving, in_c):
    """An FMU that logs in every call: no exception passes through it, so the run ends after the step."""
    files, talker = [part.source.path for part in moving.components.values()], fmus.make("quirk", "talker")
    *_, complete = interrupted(*files, "jacobi", in_c, 1.0, talker=[talker], steps=0)
    assert complete == "False"


GROWTH = entry(__file__, "growth")
LONG_RUNS = [{"master": "jacobi"}, {"master": "hermite", "passes": 2}, {"master": "gauss-seidel", "order": 2}]
on_linux = needs("Linux", "looks into /proc")


def grown(system, coupling, steps, rows=10):
    """By how much a process grows after the first tenth of a run [byte], looked at every 256 steps."""
    files = [part.source.path for part in system.components.values()]
    # NumPy asks for pages of 2 MB for large arrays: the first rows would take most of the memory at once
    return int(in_new_process(START + GROWTH, *files, coupling, steps, rows, NUMPY_MADVISE_HUGEPAGE="0"))


@on_linux
@pytest.mark.parametrize(
    ("steps", "most"), [(200_000, 60_000), pytest.param(10_000_000, 300_000, marks=shards.search)]
)
@pytest.mark.parametrize("coupling", LONG_RUNS, ids=str)
def test_memory_does_not_grow_with_the_steps(moving, coupling, steps, most):
    """With ten rows of record; the long runs are three hours of machine time."""
    # a few pages that Python takes late, measured 16 kB; a byte per step would be 200 000 and 10 million
    assert grown(moving, coupling, steps) < most


@on_linux
def test_what_is_recorded_takes_memory(moving):
    """That growth would be seen: 200 000 rows of the time and seven signals, but for the first tenth."""
    expected, found = 0.9 * 200_000 * 8 * 8, grown(moving, {"master": "jacobi"}, 200_000, 200_000)  # [byte]
    # a look every 256 steps is 16 kB late, and Python takes as much for itself; measured within 2e-3
    assert found == pytest.approx(expected, rel=5e-3)
