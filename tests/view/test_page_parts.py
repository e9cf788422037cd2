"""What the server of the page is made of: history, frames to slow pages, choices, files."""

import math
import shlex
import socket
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from kit.mistakes import problem, table
from view.standin import StandIn

from orchestrator.data.trace import Trace, read_trace
from orchestrator.data.trace_writer import write_trace
from orchestrator.drive import page
from orchestrator.drive import view_description as described
from orchestrator.drive.sticks import modes
from orchestrator.drive.view_description import Slider, by_bare_name, view_description
from orchestrator.ssp.load import assemble, load
from orchestrator.ssp.system import System
from orchestrator.ssp.write import write_ssp
from orchestrator.view.choice import MachineChoice, plan, poses, variants
from orchestrator.view.live import AHEAD, BIN, LOST, WINDOW, Credit, History, extremes, next_choice, offered
from orchestrator.view.server import bound
from orchestrator.view.session import Session, columns

SHAPES = st.tuples(st.integers(1, 30), st.integers(1, 4))


@given(rows=arrays(np.float64, SHAPES, elements=st.floats(-1e8, 1e8)))
def test_extremes(rows: np.ndarray) -> None:
    """Thinning out keeps the lowest and the highest value of each column, so no peak is lost."""
    kept = extremes(rows)
    assert (kept.min(axis=0) == rows.min(axis=0)).all()
    assert (kept.max(axis=0) == rows.max(axis=0)).all()


def peaks(history: History) -> list[float]:
    """Largest values of the signals."""
    return list(np.concatenate(list(history.bins.values())).max(axis=0))


def test_history() -> None:
    """A spike of one frame stays in sight for the window, and is gone after it; a restart begins anew."""
    machine = StandIn(("boom_command",), ("manipulator.boom_speed",), still={"boom_command": 1.0})
    machine.frames = [(0.01 * k, [9.0 if k == 137 else 0.5]) for k in range(1000)]
    history = History(machine, columns(machine), ["boom_command", "boom_speed", "unknown"])
    history.look()
    *known, unknown = peaks(history)
    assert known == [1.0, 9.0]
    assert math.isnan(unknown), "a curve that is not in the file"
    (last,) = history.since(49)
    assert last == (49, [1.0, 0.5, None], [1.0, 0.5, None])
    machine.frames += [(0.01 * k, [0.5]) for k in range(1000, 1000 + round(WINDOW / 0.01))]
    history.look()
    assert peaks(history)[1] == 0.5
    assert len(history.bins) <= WINDOW / BIN + 1
    machine.frames += [(0.01 * k, [0.1]) for k in range(50)]
    history.look()
    assert peaks(history)[1] == 0.1
    empty = History(machine, columns(machine), ["unknown"])
    empty.look()
    assert empty.bins == {}, "none of the curves is in the file"


def test_credit() -> None:
    """A page that draws nothing gets no more pictures; one that catches up does, a silent one later."""
    now = [0.0]
    credit = Credit(lambda: now[0])
    for number in range(1, AHEAD + 1):
        assert credit.next() == number
        credit.sent = number
    assert credit.next() == 0
    credit.shown(4)
    assert credit.next() == AHEAD + 1
    credit.shown(10**6)
    assert credit.drawn == 4, "what was never sent cannot have been drawn"
    for number in range(AHEAD + 1, AHEAD + 5):
        credit.sent = number
    assert credit.next() == 0
    now[0] = LOST + 0.1
    assert credit.next() > 0


def test_names() -> None:
    """Where several components have a name, that component is meant with whose name it begins."""
    found = by_bare_name(["swing.supply_flow", "supply.supply_flow", "boom_stick.supply_flow", "a.b.angle"])
    assert found == {"supply_flow": "supply.supply_flow", "angle": "a.b.angle"}


def test_choice(fmu_dir: Path) -> None:
    """Poses and variants are those of the files; the valves are driven instead of the levers' program."""
    system = fmu_dir / "harvester.ssp"
    assert set(poses(system)) == {"close", "folded", "nominal", "raised", "reach"}
    assert set(variants(system)["swing"]) >= {"usual", "lumped", "detailed", "quasistatic", "compensated"}
    assert "operator_input" not in variants(system)
    found = plan(MachineChoice(system)).setup
    levers = ["swing_command", "boom_command", "stick_command"]
    assert [axis.name for axis in found.axes] == [*levers, "payload_mass"]
    assert not [name for name in found.signals if name.startswith("operator_input.")]


def test_choice_with_a_controller(fmu_dir: Path) -> None:
    """With a controller the levers and the velocities of the tip are driven, and it can be engaged."""
    system = load(fmu_dir / "harvester_control.ssp")
    description = view_description(system)
    names = set(description.driven(system))
    assert {"boom_lever", "radial_velocity", "vertical_velocity", "swing_velocity", "engaged"} <= names
    assert "boom_command" not in names
    uses = ("tip_error", "reference_share", "stroke_use", "speed_use")
    assert {f"controller.{name}" for name in uses} <= set(description.watched(system))


@pytest.fixture(scope="module")
def bench(fmu_dir: Path) -> System:
    """A drive alone, which has no description of its view."""
    return assemble({"swing": fmu_dir / "swing.fmu"}, (), name="bench", stop=1.0, step=1e-3)


def test_a_machine_without_a_description(bench: System, tmp_path: Path) -> None:
    """Its outputs are gauges in the units that people read, and charts; its free inputs have sliders."""
    found = plan(MachineChoice(write_ssp(bench, tmp_path / "bench.ssp")))
    lines = {line.name: line for group in found.description.gauges for line in group.lines}
    assert lines["swing_pressure_a"].unit == "bar"
    assert set(found.description.curves) <= set(lines) == {p.rpartition(".")[2] for p in found.setup.signals}
    assert (found.parameters, dict(found.description.modes)) == (None, {})
    assert len(lines) <= len(bench.ports("output"))
    assert len(found.description.charts) == min(6, len({line.unit for line in lines.values()}))
    limits = {n: bench.variable(bench.port(f"swing.{n}")).bounds for n in lines}
    assert all((lines[n].high is None) == (not np.isfinite(limits[n]).all()) for n in lines)
    sliders = {slider.name: slider for slider in found.description.sliders}
    axes = {axis.name: axis for axis in found.setup.axes}
    assert set(sliders) == set(axes)
    assert {"swing_command", "supply_pressure"} <= set(axes)
    assert not [name for name in axes if name.endswith("_rate")], "slopes follow their input"
    supply = axes["supply_pressure"]
    assert supply.rest == pytest.approx(sliders["supply_pressure"].start)
    assert supply.limit >= abs(supply.rest)


def test_only_what_is_offered_is_started(fmu_dir: Path) -> None:
    """A page chooses among the systems of the folder and their variants, not other files."""
    now = MachineChoice(fmu_dir / "harvester.ssp", "", {"swing": "detailed"})
    offer = offered(now)
    assert {"harvester.ssp", "harvester_control.ssp"} <= set(offer["systems"])
    assert offer["chosen"] == {"system": "harvester.ssp", "pose": "", "swap": {"swing": "detailed"}}
    swap = {"swing": "usual", "manipulator": "pendulum"}
    asked = {"system": "harvester.ssp", "pose": "reach", "swap": swap}
    found = next_choice(now, asked)
    assert (found.pose, dict(found.swap)) == ("reach", {"manipulator": "pendulum"})
    for wrong in (
        *({"system": "../x.ssp"}, {"system": None}, {"pose": 1}, {"swap": {"x": "y"}}),
        *({"swap": {"swing": no_name}} for no_name in ("../x.fmu", {"a": 1}, ["b"], 5)),
    ):
        problem(lambda wrong=wrong: next_choice(now, asked | wrong))


@table(__file__, "wrong", "text, message")
def test_a_description_that_is_wrong(bench: System, tmp_path: Path, text: str, message: str) -> None:
    """One line with what was expected and what was got."""
    path = write_ssp(bench, tmp_path / "bench.ssp", resources={"view.toml": text.encode()})
    assert message in problem(lambda: plan(MachineChoice(path)))


def test_a_machine_in_one_fmu(fmu_dir: Path) -> None:
    """It brings the same description; no controller, so no tip mode."""
    found = plan(MachineChoice(fmu_dir / "harvester.fmu"))
    assert found.description == plan(MachineChoice(fmu_dir / "harvester.ssp")).description
    assert found.parameters is not None
    assert modes(found.description.modes, [axis.name for axis in found.setup.axes]) == ("levers",)


@pytest.mark.parametrize("start", [20.7e6, 15e6])
def test_a_free_input_with_a_slider(fmu_dir: Path, start: float) -> None:
    """It can be set, as its slider has it, and rests at its start value; one of [[axes]] keeps its limits."""
    choice = MachineChoice(fmu_dir / "harvester.fmu", set={"supply_pressure": str(start)})
    axes = {axis.name: axis for axis in plan(choice).setup.axes}
    pressure = axes["supply_pressure"]
    assert (pressure.limit, pressure.rate, pressure.rest) == (pytest.approx(25e6), 20e6, start)
    assert axes["payload_mass"].limit == 1000


def test_units_of_an_fmu(bench: System) -> None:
    """Values of an FMU in bar are shown in bar, in ends, steps and factors, not divided by 1e5 once more."""
    own = bench.variable(bench.port("swing.swing_pressure_a"))
    assert own.unit is not None
    declared = {**own.attributes, "unit": "bar", "min": "0", "max": "400"}
    variable = replace(own, unit=replace(own.unit, name="bar"), attributes=declared)
    gauge = page._shown(described._gauge("p", "p", variable))
    assert (gauge["unit"], gauge["high"], gauge["factor"], gauge["si"]) == ("bar", 400.0, 1.0, 1e5)
    slider = Slider("p", "p", "bar", 6.0, 250.0, 1.0, fmu_unit="kPa")
    assert slider.ends == pytest.approx((600.0, 25000.0))
    assert slider.driven(0.0).limit == pytest.approx(25000.0)
    assert slider.driven(0.0).rate == pytest.approx(24400.0), "from end to end in 1 s"


@pytest.mark.parametrize("begin", [0.0, 10.0])
def test_the_beginning_of_a_drive(fmu_dir: Path, tmp_path: Path, begin: float) -> None:
    """A drive can be repeated by the command that is told, unless its beginning is no longer in memory."""
    trace = Trace(begin + np.arange(3.0), {"u": np.zeros(3), "a.x": np.ones(3)})
    live: Any = SimpleNamespace(drives=True, axes=("u",), signals=("a.x",), trace=lambda: trace)
    choice = MachineChoice(fmu_dir / "harvester.ssp", "reach", {"swing": "detailed"})
    session = Session(choice, [folder := tmp_path / "my results"], lambda _: live)
    told = session.repeated(session.save())
    if begin:
        assert told == "its beginning is no longer in memory, so it cannot be repeated"
        assert not list(folder.glob("drive-*"))
        return
    (drive,) = folder.glob("drive-*.csv")
    assert list(read_trace(drive).signals) == ["u"]
    words = ["harvester", "run", str(choice.system), "--scenario", str(drive), "--pose", "reach"]
    assert shlex.split(told.removeprefix("the same drive: ")) == [*words, "--swap", "swing=detailed"]


def test_start_values(fmu_dir: Path) -> None:
    """Start values go to the machine."""
    found = plan(MachineChoice(fmu_dir / "harvester.ssp", set={"manipulator.stick_length": "2.5"}))
    assert found.parameters["stick_length"] == 2.5
    assert found.setup.set


def test_files_that_can_be_replayed(fmu_dir: Path, tmp_path: Path) -> None:
    """Only files with an angle of a joint are offered; of each the header is enough."""
    still = {"manipulator.boom_angle": np.zeros(2)}
    for name, signals in (("a.csv", still), ("b.parquet", still), ("path.csv", {"tip_x": np.zeros(2)})):
        write_trace(Trace(np.arange(2.0), signals), tmp_path / name)
    (tmp_path / "torn.parquet").write_bytes(b"PAR1")
    (tmp_path / "text.csv").write_bytes(b"\xff")
    (tmp_path / "cut.csv").write_text("time,boom_angle\nno number")
    session = Session(MachineChoice(fmu_dir / "harvester.ssp"), [tmp_path], lambda _: StandIn())
    assert session.files() == ["a.csv", "b.parquet", "cut.csv"]
    data = session.recording("b.parquet")
    assert (data["title"], data["replay"]["columns"]) == ("Replay: b.parquet", {"boom_angle": [0.0] * 26})
    assert "no such result file" in problem(lambda: session.recording("../a.csv"))


def test_another_machine_is_not_replayed(bench: System, tmp_path: Path) -> None:
    """Without a drawing, a run with some of the names is none of this machine; half of the signals are."""
    path = write_ssp(bench, tmp_path / "bench.ssp")
    shown = [name.rpartition(".")[2] for name in plan(MachineChoice(path)).setup.signals]
    for file, names in (("few.csv", shown[:3]), ("half.csv", shown[: (len(shown) + 1) // 2])):
        write_trace(Trace(np.arange(2.0), {f"x.{n}": np.zeros(2) for n in names}), tmp_path / file)
    session = Session(MachineChoice(path), [tmp_path], lambda _: StandIn())
    assert session.files() == ["half.csv"]
    told = f"expected {(len(shown) + 1) // 2} or more signals such as swing"
    problem(lambda: session.recording("few.csv"), rf"{told}\.")


def test_port_in_use() -> None:
    """A port that is taken is told in one line."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        message = problem(lambda: bound("127.0.0.1", port))
    assert message.startswith(f"--host 127.0.0.1 --port {port}: cannot listen: ")
    assert message.endswith("; --port 0 selects a free port")
