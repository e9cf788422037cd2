"""A run that was saved goes on bit for bit: in another process, with all masters, steps and kinds of FMUs."""

import hashlib
import io
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from kit.any_fmu.models import bank_fmu, oscillator_of
from kit.mistakes import problem

from orchestrator import Coupling, Master, Trace, assemble, run
from orchestrator.base import files
from orchestrator.engine import saved_run

MASTERS = {
    "jacobi of order 3": Coupling("jacobi", order=3),
    "gauss-seidel": Coupling("gauss-seidel"),
    "hermite": Coupling("hermite"),
    "interface-jacobian": Coupling("interface-jacobian"),
    "adaptive": Coupling("gauss-seidel", adaptive=1e-4),
    "adaptive hermite": Coupling("hermite", adaptive=1e-5),
}
STOP, HALF = 2.0, 1.0


@pytest.fixture(scope="module")
def bank(once):
    return once("bank", lambda folder: bank_fmu(folder / "bank.fmu")) / "bank.fmu"


@pytest.fixture(params=["oscillator", "arrays", "Model Exchange"])
def system(request, fmus, bank):
    """FMI 2.0; FMI 3.0; an FMU that a solver of this project integrates."""
    if request.param == "oscillator":
        return oscillator_of(fmus["mass_a"], fmus["mass_b"])
    ring = assemble({"a": bank, "b": bank}, ["a.y[1] -> b.u[2]", "b.y[2] -> a.u[3]"], {"a.u[1]": 1.0})
    return ring.in_kind("ModelExchange", "b") if request.param == "Model Exchange" else ring


def same(part, whole):
    """Are the rows of a run those at the end of another one, in all bits?"""
    last = slice(len(whole.time) - len(part.time), None)
    signals = all(np.array_equal(part[name], whole[name][last]) for name in whole.signals)
    return signals and np.array_equal(part.time, whole.time[last])


@pytest.mark.parametrize("master", MASTERS.values(), ids=[*MASTERS])
def test_two_halves_are_the_whole(system, master, tmp_path):
    """The first half in the process of a run, the second in this one; its rows begin at the state."""
    options = {"master": master, **({"record_step": 0.1} if master.adaptive else {"step": 0.01})}
    whole = run(system, stop=STOP, **options)
    run(system, stop=HALF, save_state=tmp_path / "half.state", **options)
    rest = run(system, stop=STOP, resume=tmp_path / "half.state", isolate=False, **options)
    assert rest.time[0] == HALF
    assert same(rest.trace, whole.trace)
    assert (rest.card.steps, rest.card.bonds) == (whole.card.steps, whole.card.bonds)
    assert any("from t = 1 s on" in note for note in rest.card.notes)


def stepping(components, time, length):
    """The function of a master that keeps nothing."""
    for component in components.values():
        component.step(time, length)


@pytest.mark.parametrize("master", ["gauss-seidel", Master("mine", step=stepping)], ids=["known", "own"])
def test_a_state_between_two_rows_and_a_scenario(fmus, tmp_path, master):
    """Saved on the way by a run of another length; rows at multiples of 4 steps; a scenario that jumps."""
    system = oscillator_of(fmus["mass_a"], fmus["mass_b"])
    scenario = Trace(np.array([0.0, 0.75, 0.75, 2.0]), {"b.force": np.array([0.0, 1.0, 3.0, 0.0])})
    options = {"step": 0.01, "record_step": 0.04, "master": master}
    whole = run(system, scenario, stop=STOP, **options)
    saved = run(system, scenario, stop=1.2, save_state=f"{tmp_path / 'on.state'}@0.5 s", **options)
    rest = run(system, scenario, stop=STOP, resume=tmp_path / "on.state", **options)
    assert rest.time[0] == 0.52
    assert same(rest.trace, whole.trace)
    assert f"the state at t = 0.5 s is in {tmp_path / 'on.state'}" in saved.card.notes
    for result, option in ((saved, "save_state"), (rest, "resume")):
        own = f"{option}: what master mine keeps in Python is not in the state"
        assert (own in result.card.notes) == (master != "gauss-seidel")


def steps_at(jumps, stop):
    """A scenario of an input that jumps to a value at each time [s]."""
    times, values = [*jumps, stop], np.array([*jumps.values()])
    return Trace(np.repeat(times, 2)[1:-1], {"a.u[2]": np.repeat(values, 2)})


@pytest.mark.parametrize("master", ["gauss-seidel", "interface-jacobian", Coupling("hermite", adaptive=1e-3)])
@pytest.mark.parametrize(
    "jumps", [{0.0: 3.0, 1.3551: 5.0}, {0.0: 8.0} | {1.0051 + 0.1 * k: float(k) for k in range(1, 10)}]
)
def test_another_scenario_after_a_state(bank, tmp_path, master, jumps):
    """As in one run that jumps at the state to the other scenario; adaptive steps have a point only there."""
    ring = assemble({"a": bank, "b": bank}, ["a.y[1] -> b.u[2]", "b.y[2] -> a.u[3]"])
    options, file = {"master": master, "step": 0.01}, tmp_path / "me@host" / "half.state"
    first = {0.0: 0.0} | {0.005 + 0.1 * k: float(k) for k in range(1, 10)}
    both = first | {t or HALF: value for t, value in jumps.items()}
    whole = run(ring, steps_at(both, STOP), stop=STOP, **options)
    run(ring, steps_at(first, HALF), stop=HALF, save_state=file, **options)
    rest = run(ring, steps_at(jumps, STOP), stop=STOP, resume=file, isolate=False, **options)
    assert (rest.time[0], rest["a.u[2]"][0]) == (HALF, jumps[0.0])
    assert same(rest.trace, whole.trace)
    assert rest.card.steps == whole.card.steps


def test_the_command_goes_on_in_another_process(bank, tmp_path):
    """`--save-state FILE@TIME` and `--resume FILE`."""

    def command(out, *more):
        given = ["run", str(bank), "--step", "0.01", "--stop", "1", "--out", str(tmp_path / out), *more]
        subprocess.run([sys.executable, "-m", "orchestrator", *given], check=True, capture_output=True)
        return (tmp_path / out).read_text().splitlines()

    whole = command("whole.csv", "--save-state", f"{tmp_path / 'a.state'}@500ms")
    rest = command("rest.csv", "--resume", str(tmp_path / "a.state"))
    assert rest[1:] == whole[-len(rest) + 1 :]
    assert float(rest[1].split(",")[0]) == 0.5


# ---- mistakes


def flipped(file):
    """A byte in the middle is another one."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 255
    file.write_bytes(data)


def text(file):
    file.write_text("a,b\n1,2\n")


def with_more(file, name="memory_9999.npy", size=1, shape=(1,)):
    """Another array, packed, with a checksum that is right."""
    data = io.BytesIO(file.read_bytes()[32:])
    with zipfile.ZipFile(data, "a", zipfile.ZIP_DEFLATED) as archive, archive.open(name, "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "|u1", "fortran_order": False, "shape": shape})
        member.write(bytes(size))
    file.write_bytes(hashlib.sha256(data.getvalue()).digest() + data.getvalue())


def bomb(file):
    """More zeros than an archive may unpack to: the limit is that of the test."""
    with_more(file, size=4_000_000, shape=(4_000_000,))


def declared(file):
    """An array of 2^60 bytes of which there is one."""
    with_more(file, shape=(1 << 60,))


def device(file):
    file.unlink()
    file.symlink_to("/dev/zero")


@pytest.fixture(scope="module")
def pair(bank):
    return assemble({"a": bank, "b": bank}, ["a.y[1] -> b.u[2]"], {"a.u[1]": 1.0})


@pytest.fixture(scope="module")
def state(pair, tmp_path_factory):
    """The bytes of a state at half the time."""
    file = tmp_path_factory.mktemp("state") / "a.state"
    run(pair, step=0.01, stop=HALF, master="gauss-seidel", save_state=file, isolate=False)
    return file.read_bytes()


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (flipped, {}, "expected the state of a run as --save-state writes it, got another or a damaged file"),
        (text, {}, "got another or a damaged file"),
        (bomb, {}, "a.state: expected at most 3 MB unpacked, got "),
        (declared, {}, "got another or a damaged file"),
        (with_more, {}, "got another or a damaged file"),
        (device, {}, "a.state: expected a file, got a device or a pipe"),
        (None, {"master": "hermite"}, "master: expected gauss-seidel of the saved run, got hermite"),
        (None, {"step": 0.02}, "step: expected 0.01 of the saved run, got 0.02"),
        (None, {"order": 2}, "setting order of the master: expected None of the saved run, got 2"),
        (None, {"set": {"a.k": "1 2 4"}}, "start values of a: expected "),
        (None, {"stop": 0.5}, "expected a stop time after t = 1 s of the state, got 0.5 s"),
        (None, {"resume": "no.state"}, "no.state: no such file"),
        (None, {"accuracy": 1e-3}, "resume: expected one run with a given master and step, got accuracy"),
        (None, {"save_state": "b.state@7s"}, "expected a time of the run, from 0 s to 2 s, got 7s"),
        (None, {"save_state": "b.state@0.505"}, "expected a communication point, such as"),
        (None, {"save_state": ""}, "save_state: expected the name of a file, FILE or FILE@TIME, got ''"),
        (None, {"save_state": "@1.5"}, "FILE or FILE@TIME, got '@1.5'"),
        (None, {"save_state": "b.state@"}, "save_state b.state@: expected "),
        (None, {"resume": ""}, "resume: expected the file of a state, got an empty name"),
    ],
)
def test_a_state_that_does_not_fit_is_told(pair, state, tmp_path, monkeypatch, change, options, message):
    """In one line, before the first step, and before a bomb is unpacked."""
    monkeypatch.setattr(files, "MAX_UNPACKED", 3_000_000)
    (tmp_path / "a.state").write_bytes(state)
    if change:
        change(tmp_path / "a.state")
    given = {"step": 0.01, "stop": STOP, "master": "gauss-seidel", "resume": tmp_path / "a.state", **options}
    if "accuracy" in options:
        del given["step"], given["master"]
    told = problem(lambda: run(pair, isolate=False, **given))
    assert message in told
    assert "\n" not in told


def test_other_fmus_are_told(bank, fmus3, tmp_path):
    """Another FMU under the same name, and one that cannot serialise its state."""
    run(str(bank), step=0.1, save_state=tmp_path / "a.state")
    other = tmp_path / "other" / "bank.fmu"
    other.parent.mkdir()
    other.write_bytes(bank.read_bytes())
    with zipfile.ZipFile(other, "a") as archive:
        archive.writestr("resources/x", "y")
    told = problem(lambda: run(str(other), step=0.1, resume=tmp_path / "a.state"))
    assert "FMU of bank: expected " in told
    plain = fmus3.make("gain", "plain", able={"canSerializeFMUState": "false"})
    told = problem(lambda: run(str(plain), step=0.1, save_state=tmp_path / "b.state"))
    assert told == "save_state: plain cannot serialise its state: expected FMUs that can"


def test_a_state_of_zeros_is_written_so_that_it_can_be_read(bank, tmp_path, monkeypatch):
    """Packed a hundred times, it would look like a bomb: then it is not packed."""
    monkeypatch.setattr(saved_run, "size_fault", lambda members, _: "x" * (members[0].compress_type > 0))
    run(str(bank), step=0.1, stop=1.0, save_state=tmp_path / "a.state", isolate=False)
    assert run(str(bank), step=0.1, stop=2.0, resume=tmp_path / "a.state", isolate=False).time[0] == 1.0
