"""Cranes from files: mistakes are told, FMUs are built, the co-simulation is the monolithic solution."""

import re
import runpy
from dataclasses import replace
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from crane.rigid_bodies import bodies
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.cranes import CRANES, EXAMPLES, changed, checked, crane, machine, solved, told_of
from kit.equations import Part
from kit.mistakes import entry, problem, table
from kit.properties import examples

from fmus.components.chain import Payload
from fmus.contract import Quantity, nested, quantities
from fmus.crane.axes import capacity, lifting_moment
from fmus.crane.check import check
from fmus.crane.check import table as text_of
from fmus.crane.controller import controller
from fmus.crane.description import NEW, new, read
from fmus.crane.machine import crane_machine, healthy, taken
from fmus.crane.manipulator import manipulator
from fmus.machine.build import with_values
from fmus.manipulator import MANIPULATOR
from fmus.parameters import Number, values
from orchestrator import load, run
from orchestrator.__main__ import main
from orchestrator.base.errors import Mistakes

DETAILED = ("compensated", "detailed")


def at_start(crane, **parameters):
    """Rates and outputs at the start, the cylinders holding."""
    of, u = Part(manipulator(crane), **parameters), {}
    for _ in range(2):
        dx, shown = of(of.start(), **u)
        for kind in ("force", "torque"):
            u |= {n: shown[n.replace(kind, f"holding_{kind}")] for n in of.inputs if n.endswith(f"_{kind}")}
    return dict(zip(of.states, dx, strict=True)), shown


@table(__file__, "mistakes", "old, by, message")
def test_a_mistake_is_told_in_one_line(tmp_path, old, by, message):
    """With file, table, key, what was expected and what was found; also what only the geometry shows."""
    path = changed(tmp_path, (old, by))
    with pytest.raises(Mistakes) as told:
        check(read(path))
    assert told.value.lines[0].startswith(f"{path}: {message}")


MOMENTS = "120 kNm, 120 kN m, 120000 Nm, 12.2366 t.m, 12.2366 tm, 12.2366 mt, 88507.5 ft.lbf, 88507.5 lb-ft"
TURN = 2 * np.pi  # rad
SHEETS = {  # key, and its value in SI units -> in the file of the loader, and as data sheets write it
    ("lifting_moment", 120e3): ("[supply]", "[datasheet]\nlifting_moment = {}\n[supply]", MOMENTS),
    ("motor_displacement", 250e-6 / TURN): ('"1.14e-3 m3/rad"', "{}", "250 ccm/rev, 250 cc/U, 0.25 L/rev"),
    ("density", 870): ('"870 kg/m3"', "{}", "870 kg m-3, 0.87 t/m3, 54.3123 lb/ft3"),
}


@pytest.mark.parametrize(
    ("key", "old", "by", "text"),
    [(key, old, by, text) for key, (old, by, texts) in SHEETS.items() for text in texts.split(", ")],
)
def test_units_of_data_sheets_are_read(tmp_path, key, old, by, text):
    """In each way of writing a number; t.m is the moment of a weight."""
    crane = read(changed(tmp_path, (old, by.format(f'"{text}"'))))
    known = {n: x.value for n, x in (crane.joints[0].numbers | crane.numbers["oil"]).items()}
    assert (known | dict(crane.datasheet))[key[0]] == pytest.approx(key[1], rel=1e-5)  # of their digits


def renamed(name):
    """The crane of `harvester crane new` with another name of its boom."""
    text = NEW.read_text(encoding="utf-8").replace("[boom]", f"[{name}]").replace("\nboom =", f"\n{name} =")
    return read(Path("named.toml"), text.encode())


@table(__file__, "used", "name, reason")
def test_a_name_that_is_used_otherwise_is_refused(name, reason):
    """By the check, before the build: the beginning of a parameter or signal, a terminal, a keyword."""
    line = problem(lambda: check(renamed(name)))
    assert line.startswith(f"named.toml: [{name}] expected another name of the joint: {reason}")


def test_all_words_of_a_machine_are_taken():
    """Those with which names of parts, drivers and additions of the new crane begin, or the axes do."""
    own = crane_machine(read(NEW), faults=True)
    subs = [s for of in own.families.values() for s in of.values()] + [*own.components.values(), *own.drivers]
    names = {n for s in subs for g in (s.parameters, s.states, s.inputs, s.outputs) for n in quantities(g)}
    words = {n.partition("_")[0] for n in names | {s.component for s in subs}}
    own = {"slew", "boom", "stick", "grapple", "drives", "swing"}  # the controller has swing_velocity
    assert words - own <= taken().keys()


@pytest.mark.parametrize("name", ["swing", "supply", "valve_actuation"])
def test_a_file_is_not_named_like_a_part(tmp_path, name):
    """The machine as one FMU has the name of the file, and would take the place of that part."""
    path = tmp_path / f"{name}.toml"
    new(path)
    told = f"{path}: expected another name of the file: {name}.fmu is a part of a machine"
    assert problem(lambda: check(read(path))) == told


@shards.machine
@pytest.mark.parametrize("name", ["cls", "name", "members", "self", "metaclass", "swing", "p", "of", "brake"])
def test_other_names_make_a_machine(name):
    """Also those of arguments and of members in our code."""
    crane = renamed(name)
    assert [a.joint.name for a in check(crane)][1] == name
    machine = crane_machine(crane, faults=True)
    assert f"{name}_command" in machine.inputs
    assert machine.controller is not None


def test_all_mistakes_are_told_at_once(tmp_path):
    """Three mistakes in three tables; the rocker is unknown, and missing."""
    three = ("mass = 370", 'mass = "370 m"'), ("rocker =", "roker ="), ('on = "grapple"', 'on = "x"')
    path = changed(tmp_path, *three)
    with pytest.raises(Mistakes) as told:
        read(path)
    tables = [re.search(r"\[(.*?)\]", line)[1] for line in told.value.lines]
    assert tables == ["boom", "jib.four_bar", "jib.four_bar", "payload"]


def test_names_that_are_used_are_told_with_other_mistakes(tmp_path, capsys):
    """By both commands, so that nobody mends a file and then learns that its names will not do."""
    path = changed(tmp_path, ("[boom]", "[return]"), ("[jib]", "[time]"), ("mass = 370", "mas = 370"))
    for command in (["crane", "check", path], ["build", "--crane", path, "--out", tmp_path / "out"]):
        assert main([str(x) for x in command]) == 2
        told = capsys.readouterr().err
        assert "[return] unknown key 'mas'" in told
        assert "[return] expected another name of the joint: Python" in told
        assert "[time] expected another name of the joint: Modelica" in told


DEAD = """
[arm]
axis = "-y"
mass = 100
centre = [1, 0, 0]
drive = "cylinder"
cylinder = { base = [2.6, 0], pin = [2.0, 0], closed = 0.600019, stroke = 0.45, bore = 0.1, rod = 0.05 }
hydraulics = { valve = "20 mm2" }
[payload]
on = "arm"
at = [1, 0, 0]
[start]
arm = "20.146 deg"
"""


def test_the_end_of_a_range_is_on_the_side_of_the_start():
    """Length^2 = 0.36 + 10.4 (1 - cos q): the piston is closed on both sides of the dead point at 0, 0.12 deg
    away, less than a step of the search; the end is the one that the arm comes to first."""
    (arm,) = check(read(Path("dead.toml"), DEAD.encode()))
    end = np.arccos(1 - (0.600019**2 - 0.36) / 10.4)
    assert arm.low == pytest.approx(end, rel=1e-9)  # of Newton's method in double precision


def test_a_crane_has_joints_in_number():
    """Thousands of tables are refused before their equations are made."""
    text = "".join(f"[j{k}]\n" for k in range(5000))
    assert "expected at most 60 joints, got 5000" in problem(lambda: read(Path("a.toml"), text.encode()))


def test_a_new_file_is_a_crane(tmp_path):
    """It is checked without a mistake, and an existing file is not overwritten."""
    path = tmp_path / "mine.toml"
    assert str(path) in new(path)
    assert [a.joint.name for a in check(read(path))] == ["slew", "boom", "stick"]
    assert "exists already" in problem(lambda: new(path))
    assert "got no folder" in problem(lambda: new(tmp_path / "no" / "mine.toml"))
    assert not (tmp_path / "no").exists()


def test_a_closed_standard_output_is_no_defect(tmp_path, monkeypatch):
    """As of `harvester ... >&-`: the command does its work."""
    monkeypatch.setattr("sys.stdout", None)
    assert main(["crane", "new", str(tmp_path / "mine.toml")]) == 0
    assert (tmp_path / "mine.toml").is_file()


PRINTS = "# check prints: "
DOUBTS = {
    "mini_excavator": ["[arm] lever down to 50 of 238 mm"],
    "knuckle_boom": ["[jib] lever down to 76 of 309 mm"],
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_example_passes_its_check(name):
    """No mistake, no doubt but of a published stroke; its loads are those that its file says are printed."""
    loads = capacity(crane(name), checked(name))
    told = text_of(crane(name), checked(name), loads, {})
    doubts = [line.partition(".toml: ")[2] for line in told.splitlines() if line.startswith("warning")]
    assert [line.partition(" near an end")[0] for line in doubts] == DOUBTS.get(name, [])
    assert loads.values[2].max() > 100
    text = crane(name).file.read_text(encoding="utf-8")
    printed = [line.removeprefix(PRINTS) for line in text.splitlines() if line.startswith(PRINTS)]
    assert all(line in told for line in printed)
    assert bool(printed) == (name not in ("feric", "loader", "patu"))
    page = (CRANES.parents[1] / "docs" / "crane.md").read_text(encoding="utf-8")
    assert all(line.removeprefix("load that can be held ") in page for line in printed)


# largest moments that the sources of the mini excavator print [kN.m], and forces at the start [kN]
PUBLISHED = {
    "mini_excavator": {"boom": (22.685, 17.54), "arm": (13.865, 9.74)},
    "knuckle_boom": {"boom": 54.7, "jib": 33.0},
}


def test_examples_agree_with_what_their_sources_print():
    """Within the digits that a model prints, and 10 % of the pressures at which the other one starts."""
    axes = {a.joint.name: a for a in checked("mini_excavator")}
    for name, moments in PUBLISHED["mini_excavator"].items():
        a = axes[name]
        own = (a.push * a.levers[1] / 1e3, a.pull * a.levers[1] / 1e3)
        assert own == pytest.approx(moments, rel=2e-3)
    axes = {a.joint.name: a for a in checked("knuckle_boom")}
    for name, force in PUBLISHED["knuckle_boom"].items():
        own = axes[name].holding * np.pi / 4 * 0.08**2 / 1e3
        assert own == pytest.approx(force, rel=0.1)


def test_the_machine_of_the_paper_has_its_holding_forces():
    """At its start pose, with the head as a point mass at the tip: those of the manipulator by hand."""
    _, shown = at_start(crane("feric"))
    of = Part(MANIPULATOR)
    _, paper = of(of.start())
    # the head hangs below the tip, which changes no torque of its weight
    for name in ("boom_holding_force", "stick_holding_force", "boom_position", "stick_position"):
        assert shown[name] == pytest.approx(paper[name], rel=1e-12)


def test_the_numbers_of_the_paper_are_typed_once():
    """feric.toml is what feric.py writes from the parameters of the parts."""
    written = runpy.run_path(str(CRANES / "feric.py"))["text"]()
    assert (CRANES / "feric.toml").read_text(encoding="utf-8") == written


@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (0.2, 0.0), (-0.1, 0.15)])
def test_passive_joints_start_at_rest(pitch, roll):
    """On any slope link and grapple hang, cylinders and the slewing motor hold: nothing moves."""
    rates, shown = at_start(crane(), base_pitch=pitch, base_roll=roll)
    assert max(map(abs, rates.values())) < 1e-9
    assert (abs(shown["slew_holding_torque"]) > 1e3) == (roll != 0)


def test_a_crane_on_tyres_has_its_tip(tmp_path):
    """A stiff passive joint below the slewing one changes neither radius nor height."""
    tyres = '[tyres]\naxis = "y"\nmass = 1\ninertia = [1, 1, 1]\nstiffness = 1e12\ndamping = 1e5\n'
    slew = '[slew]\naxis = "z"'
    soft = read(changed(tmp_path, (slew, tyres + slew)))
    (_, own), (_, shown) = (at_start(c) for c in (soft, crane()))
    for name in ("crane_tip_radius", "crane_tip_height"):
        assert own[name] == pytest.approx(shown[name], abs=1e-6)  # the spring gives way by 1e-7 rad


@shards.machine
@pytest.mark.parametrize("swap", [{}, *({"drives": d, "supply": "load_sensing"} for d in DETAILED)], ids=str)
def test_the_loader_co_simulates_like_its_monolith(loader_folder, swap):
    """Jacobi at 1 ms over the strokes of all levers: within 1e-4 of the range of the monolithic solution.

    The energy at each bond closes to 1e-3 of what passes.
    """
    system = load(loader_folder / "loader.ssp")
    found = run(system, stop=20.0, master="jacobi", step=1e-3, record="manipulator.*", swap=swap)
    solution = solved(loader_folder, "loader", 20.0, **swap)
    for name in ("boom_angle", "jib_angle", "extension_extension", "link_angle", "boom_holding_force"):
        true = solution[f"manipulator.{name}"]
        at = np.interp(found.time, solution["time"], true)
        assert np.sqrt(np.mean((found[f"manipulator.{name}"] - at) ** 2)) < 1e-4 * np.ptp(true)


def test_a_passive_joint_without_damping_is_a_warning(tmp_path):
    """A line below the tables, no mistake; the example has none."""
    path = changed(tmp_path, ("damping = 60\n\n[grapple]", "\n[grapple]"))
    (line,) = (line for line in told_of(read(path)).splitlines() if "warning" in line)
    assert line == f"warning: {path}: [link] passive, without damping and friction: it swings for ever"


def test_a_small_lever_is_a_warning_and_the_dead_point_ends_a_run(tmp_path):
    """A longer stroke of the boom leaves a tenth of the lever; beyond the dead point the FMU refuses."""
    crane = read(changed(tmp_path, ('stroke = "610 mm"', 'stroke = "666 mm"')))
    assert re.search(r"\[boom\] lever down to \d+ of 401 mm near an end of the stroke", told_of(crane))
    of = Part(manipulator(crane))
    required = of.of(of.model.require)
    assert required(of.start())[0].min() > 0
    (kept,) = required(of.start(boom_angle=1.9))  # the lever has passed zero
    lever = "boom_angle keeps the pins of the boom cylinder out of line (J > 0)"
    assert kept[of.model.statements.index(lever)] < 0


def test_a_number_has_the_bounds_of_the_file_in_the_fmu():
    """Stroke of a piston, slope of the base, mass of a link: they are declared once."""
    known = quantities(manipulator(crane()).parameters)
    bounds = {n: (known[n].minimum, known[n].maximum) for n in ("boom_stroke", "base_pitch", "jib_mass")}
    assert bounds == {"boom_stroke": (0.01, 100), "base_pitch": (-1.5, 1.5), "jib_mass": (0, 1e6)}


def test_a_number_that_nobody_gives_is_an_error():
    """A parameter of a drive has a default in the paper's machine or in its declaration, not 0 in silence."""
    assert healthy(Quantity("m2", "Opening", value=0.0)) == Number(0.0, "m2", "derived", "healthy")
    problem(
        lambda: healthy(Quantity("m", "Length of a new thing")), "Length of a new thing: expected a value"
    )


def test_a_payload_of_the_file_is_held_from_the_start(tmp_path):
    """By the program of the operator, and the pressure of the return line is that of the file."""
    payload = ('on = "grapple"', 'on = "grapple"\nmass = "300 kg"')
    own = crane_machine(read(changed(tmp_path, payload, ("[supply]", '[supply]\nreturn = "4 bar"'))))
    operator = Part(own.operator)
    assert operator(operator.start())[1]["payload_mass"] == 300
    assert values(own.families["supply"]["load_sensing"]).p["reservoir_pressure"] == 4e5


def test_a_parameter_set_changes_a_crane_as_it_does_the_harvester(tmp_path):
    """The manipulator, what holds it at the start, the controller's copies and its own gains, in any unit."""
    given = {"boom_mass": (0.5, "t"), "controller.centring": (0.2, "1"), "boom_bore": (125.0, "mm")}
    entry = '[parameters."{}"]\nvalue = {}\nunit = "{}"\nsource = "identified"\nnote = ""\n'
    (tmp_path / "own.toml").write_text("".join(entry.format(n, *x) for n, x in given.items()))
    shipped = machine()
    own = with_values(shipped, tmp_path / "own.toml", partial(controller, crane()))
    assert values(own.subsystems["manipulator"]).p["boom_mass"] == 500.0
    assert values(own.controller).p["centring"] == 0.2
    for sub in (own.controller, own.subsystems["drives"]):
        assert values(sub).p["boom_bore"] == pytest.approx(0.125, rel=1e-15)  # rounding of the unit
    held, before = (values(m.subsystems["drives"]).u["boom_holding_force"] for m in (own, shipped))
    assert held > before > 0


BOOM = entry(__file__, "boom")


SLIDE = entry(__file__, "slide")


def test_a_level_slide_does_not_limit_the_load():
    """Below the boom it carries no weight along its axis: the loads are those of the boom, and not zero."""
    cranes = (read(Path("boom.toml"), text.encode()) for text in (BOOM, SLIDE + BOOM))
    alone, below = (capacity(crane, check(crane)).values[2].max() for crane in cranes)
    assert below == pytest.approx(alone, rel=1e-3)  # the grid of angles is another one


def test_loads_and_mode_of_one_boom_are_the_closed_forms():
    """(F lever - m g x/2)/(g x) in each pose; sqrt(k/I) of the oil; the data sheet beside them."""
    crane = read(Path("boom.toml"), BOOM.encode())
    (axis,) = found = check(crane)
    loads = capacity(crane, found)
    angle = np.arcsin((loads.values[1] - 1) / 2)
    base, pin = 0.3 - 0.8j, 0.5 * np.exp(1j * angle)
    length = np.abs(pin - base)
    lever = np.gradient(length, angle)
    head, gravity = np.pi / 4 * 0.08**2, values(MANIPULATOR).p["gravity"]
    expected = (2e7 * head * lever / gravity - 100 * np.cos(angle)) / (2 * np.cos(angle))
    inner = slice(2, -2)  # differences at the ends are of first order
    np.testing.assert_allclose(loads.values[2][inner], expected[inner], rtol=1e-3)
    position = float(np.interp(0.0, angle, length)) - 0.6
    hose, rod = np.pi / 4 * 0.02**2 * 2, head - np.pi / 4 * 0.04**2
    volumes = np.array([head * position, rod * (0.4 - position)]) + 3e-4 + hose
    stiffness = 1.2e9 * (np.array([head, rod]) ** 2 / volumes).sum()
    own = np.sqrt(stiffness * np.interp(0.0, angle, lever) ** 2 / (30 + 100)) / (2 * np.pi)
    assert axis.mode == pytest.approx(own, rel=1e-3)  # of the differences
    assert lifting_moment(found) == pytest.approx(2e7 * head * lever.max(), rel=1e-3)
    text = text_of(crane, found, loads, {})
    assert re.search(r"lifting moment, gross \[kN\.m\] +40 +[\d.]+ +[+-]", text)
    assert re.search(r"reach \[m\] +2 +2 +[+-]0\.0 %", text)
    assert re.search(r"load at 2 m \[kg\] +1500 +\d+ +[+-]", text)


WORKING = (
    ("[slew]", '[tilt]\naxis = "x"\nstiffness = 4e5\ndamping = 3e3\n\n[slew]'),
    ('on = "grapple"', 'on = "grapple"\nlength = "4 m"\nalong = "y"'),
    ("[oil]", '[ground]\nheight = "0.4 m"\nfriction = 0.5\n\n[oil]'),
)


def test_energy_closes_with_ground_springs_and_a_force_on_the_tip(tmp_path):
    """At random states: power of drives, tip force and payload less heat is the rate of all energies."""
    crane = read(changed(tmp_path, *WORKING))
    of, rng = Part(manipulator(crane)), np.random.default_rng(3)
    stored = ("kinetic_energy", "potential_energy", "stop_energy", "elastic_energy")
    y = ca.vertcat(*(of.expressions["y"][n] for n in stored))
    rates = of.of(ca.jtimes(y, of.model.x, of.model.dx))
    touched = 0
    for _ in range(40):
        state = {n: rng.uniform(-0.5, 0.5) for n in of.states} | {"held_mass": 200.0, "payload_flow": 50.0}
        state |= {"boom_angle": rng.uniform(-0.3, 0.3), "jib_angle": rng.uniform(-1.6, -1.0)}
        state |= {"extension_extension": rng.uniform(0.1, 1.7)}
        forces = (n for n in of.inputs if "force" in n or "torque" in n)
        u = dict.fromkeys(of.inputs, 0.0) | {n: rng.uniform(-1e4, 1e4) for n in forces}
        u = {n: 0.0 if n.endswith("_rate") else x for n, x in u.items()}
        x = np.array([state[n] for n in of.states])
        _, s = of(x, **u)
        given = sum(u[f"{n}_force"] * s[f"{n}_velocity"] for n in ("boom", "jib", "extension"))
        given += u["slew_torque"] * s["slew_speed"] + s["tip_force_power"] + s["payload_power"]
        (changes,) = rates(x, **u)
        # an identity; the energies of stops and ground are much larger than their sum
        size = np.abs(changes).sum() + abs(given) + s["dissipated_power"]
        assert abs(changes.sum() - given + s["dissipated_power"]) < 1e-9 * size
        touched += s["ground_force"] > 0
    assert 5 < touched < 40


def test_an_elastic_base_and_a_log_start_at_rest(tmp_path):
    """Nothing moves; the base leans to the side of the crane."""
    crane = read(changed(tmp_path, *WORKING[:2], ("[start]", '[start]\nslew = "90 deg"')))
    rates, shown = at_start(crane, base_pitch=0.0)
    assert max(map(abs, rates.values())) < 1e-9
    tilted, _ = at_start(crane, tilt_stiffness=8e5)
    assert max(map(abs, tilted.values())) < 1e-9
    # to the left it leans to the left, which is a negative angle about x
    assert -0.3 < shown["tilt_angle"] < -0.05


def test_a_log_that_is_slewed_needs_its_moment_of_inertia(tmp_path):
    """m L^2/12 about the slewing axis beside the point mass."""
    point, log = (read(changed(tmp_path, ("[start]", "[start]"), *c)) for c in ((), WORKING[1:2]))
    found = []
    for each in (point, log):
        sub = manipulator(each)
        own, v = sub.model, values(sub)
        p = nested(own.parameters, v.p)
        q = ca.DM([v.p[f"initial_{j.coordinate}"] for j in each.joints if not j.follows])
        motion = own.chain(p).equations(ca.SX(q), ca.SX(q * 0), own.payload(300, p))
        found.append(float(ca.evalf(motion.mass[0, 0])))
    assert found[1] - found[0] == pytest.approx(300 * 4**2 / 12, rel=1e-9)


NUMBER = st.floats(-1.0, 1.0).map(lambda x: round(x, 3))


@st.composite
def texts(draw):
    """Descriptions of 2 to 7 joints in a tree: motors, passive joints and free slides."""
    lines, count = [], draw(st.integers(2, 7))
    for k in range(count):
        slides = draw(st.booleans()) and k > 0
        lines += [f"[j{k}]", f'joint = "{"prismatic" if slides else "revolute"}"']
        lines.append(f'axis = "{draw(st.sampled_from(["x", "y", "z", "-x", "-y", "-z"]))}"')
        if k:
            lines.append(f'parent = "j{draw(st.integers(max(k - 2, 0), k - 1))}"')
        lines += [f"at = {[draw(NUMBER) for _ in 'xyz']}", f"mass = {round(abs(draw(NUMBER)) * 200 + 1, 2)}"]
        lines.append(f"centre = {[draw(NUMBER) for _ in 'xyz']}")
        lines.append(f"damping = {round(10 * abs(draw(NUMBER)), 3)}")
        a, b, c = (round(abs(draw(NUMBER)) + 0.1, 3) for _ in "xyz")
        lines.append(f"inertia = {[a + b, b + c, a + c]}")  # of a lamina and a bit: always a body
        if not slides and (k == 0 or draw(st.booleans())):
            lines.append('drive = "motor"\nmotor = { displacement = "1e-4 m3/rad" }')
    lines += [f'[payload]\non = "j{count - 1}"\nat = {[draw(NUMBER) for _ in "xyz"]}']
    lines += [f"[base]\npitch = {draw(NUMBER) / 3}\nroll = {draw(NUMBER) / 3}"]
    return "\n".join(lines)


@given(texts(), st.integers(0, 2**32 - 1))
@examples(25)
def test_any_crane_moves_as_in_pinocchio(pin, text, seed):
    """Of a random file: M q'' + V + G is the torque of motors and friction."""
    crane, rng = read(Path("random.toml"), text.encode()), np.random.default_rng(seed)
    of = Part(manipulator(crane))
    x = dict(zip(of.states, rng.uniform(-1, 1, len(of.states)), strict=True))
    x |= {"held_mass": rng.uniform(0, 300), "payload_flow": 0.0}
    u = {n: rng.uniform(-1e3, 1e3) if n.endswith("torque") else 0.0 for n in of.inputs}
    dx, shown = of(np.array([*x.values()]), **u)
    rates = dict(zip(of.states, dx, strict=True))
    own = of.sub.model
    chain = own.chain(nested(own.parameters, of.p))
    vectors = [{n: floats(getattr(link, n)) for n in ("at", "centre", "inertia")} for link in chain.links]
    numbers = [replace(k, mass=float(k.mass), **v) for k, v in zip(chain.links, vectors, strict=True)]
    load = Payload(len(numbers) - 1, tuple(of.p[f"tip_at_{n}"] for n in "xyz"), x["held_mass"])
    tree, data = bodies(pin, numbers, [float(g) for g in chain.gravity], load)
    speeds = [f"{j.name}_speed" for j in crane.joints]
    q = np.array([x[j.coordinate] for j in crane.joints])
    w, a = (np.array([of_all[n] for n in speeds]) for of_all in (x, rates))
    needed = pin.rnea(tree, data, q, w, a)
    damping = np.array([j["damping"] for j in crane.joints])
    torque = [u.get(f"{j.name}_torque", 0.0) for j in crane.joints] - damping * w
    # the solution of a system; its terms are up to 1e4 N.m
    np.testing.assert_allclose(needed, torque, rtol=0, atol=1e-9 * max(1e3, np.abs(needed).max()))
    assert shown["dissipated_power"] == pytest.approx(damping @ w**2)


def floats(numbers):
    """Plain numbers of expressions without symbols."""
    return tuple(float(ca.evalf(ca.SX(x))) for x in numbers)
