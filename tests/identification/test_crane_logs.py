"""Valve, leakage and masses of a small crane from a log, against the machine that made it."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from kit.cranes import told_of
from kit.equations import corners, played

from fmus.crane.description import read
from fmus.crane.machine import crane_build, crane_machine
from fmus.identification.crane import Crane, identify, keys, run
from fmus.identification.procedures.flow_balance import EDGES
from fmus.identification.procedures.procedure import Contradicted, Fit, NotAsked, delay_of, fit_of, solve
from fmus.identification.results import Estimate, ProcedureResult
from fmus.machine.machine import wiring
from fmus.monolith import join
from fmus.parameters import numbers, write
from orchestrator.base.errors import Problem

FILE = """
title = "A boom with a hanging hook"
[slew]
axis = "z"
mass = "200 kg"
inertia = [20, 20, 10]
drive = "motor"
motor = { displacement = "160 cm3/rev", ratio = 60 }
hydraulics = { valve = "12 mm2", hose = "1 m" }
[boom]
axis = "-y"
at = [0, 0, "1 m"]
mass = "300 kg"
centre = ["1.5 m", 0, "0.2 m"]
inertia = [0, 300, 300]
drive = "cylinder"
cylinder = { base = ["0.35 m", "-0.9 m"], pin = ["0.5 m", "0.1 m"], closed = "0.85 m", stroke = "0.55 m", bore = "80 mm", rod = "45 mm", friction = "400 N" }
hydraulics = { valve = "20 mm2", hose = "2 m" }
[payload]
on = "boom"
at = ["3 m", 0, 0]
[start]
boom = "20 deg"
"""  # noqa: E501  (tables of TOML on one line)
TRUE = {
    "drives.boom_valve_area": 2.3e-5,
    "drives.boom_valve_dead_band": 0.75,
    "drives.boom_seal_conductance": 3e-13,
    "drives.slew_valve_area": 1.05e-5,
    "manipulator.boom_mass": 345.0,
}
ANGLE, PRESSURE = np.deg2rad(0.02), 1e4  # noise of sensors


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    """The crane of `FILE`."""
    file = tmp_path_factory.mktemp("crane") / "hook.toml"
    file.write_text(FILE, encoding="utf-8")
    return read(file)


@pytest.fixture(scope="module")
def simulated(described):
    """Outputs of the machine with oil columns in its hoses, with other parameters than in the file."""
    machine = crane_machine(described, faults=True)
    parts = machine.subsystems | machine.feeding
    model = join(parts, *wiring(parts))
    p = model.p.copy()
    for n, value in TRUE.items():
        p[model.parameters.index(n)] = value
    up = [0, 1, 1.5, 3, 3.5, 4.5, 5, 6, 6.5, 7.5, 7.8, 8.6, 8.9, 9.5, 9.8, 10.6, 10.9]
    boom = [0, 0, 3, 3, 0, 0, -2.5, -2.5, 0, 0, 5, 5, 0, 0, -4, -4, 0]
    slew = [0, 0, 2, 2, 0, 0, -3, -3, 0, 0, 4, 4, 0, 0, -5, -5, 0]
    given = {"boom_command": (up, boom), "slew_command": (np.add(up, 1.0), slew)}
    time, commands = corners(22.0, given, rate=100)
    return played(model, time, commands, p, tolerance=1e-7) | commands


def log(y, folder, *left_out, places=None):
    """A log of the simulated machine, as a logger writes it; some columns are left out.

    places   unit -> decimals to which readings are rounded; None: they have noise
    """
    noise = np.zeros if places else np.random.default_rng(1).standard_normal
    size, columns = y["time"].size, {"time [s]": y["time"]}
    for n in ("slew_angle", "boom_angle"):
        columns[f"{n} [deg]"] = np.rad2deg(y[f"manipulator.{n}"] + ANGLE * noise(size))
    for n in ("boom_head_pressure", "boom_rod_pressure", "slew_pressure_a", "slew_pressure_b"):
        columns[f"{n} [bar]"] = (y[f"drives.{n}"] + PRESSURE * noise(size)) / 1e5
    columns |= {f"{n}_command [V]": y[f"{n}_command"] for n in ("boom", "slew")}
    for n in columns:
        if (unit := n.rpartition(" ")[2]) in (places or {}):
            columns[n] = np.round(columns[n], places[unit])
    kept = {n: x for n, x in columns.items() if n.partition(" ")[0] not in left_out}
    path = folder / "log.csv"
    np.savetxt(path, np.array([*kept.values()]).T, "%.7g", ",", header=",".join(kept), comments="")
    return path


@pytest.fixture(scope="module")
def found(described, simulated, tmp_path_factory):
    """The report of all signals, and the parameters that it wrote."""
    folder = tmp_path_factory.mktemp("found")
    return run(described, log(simulated, folder), folder / "found.toml"), folder / "found.toml"


def test_intervals_hold_the_machine_that_made_the_log(found):
    """Each interval, a little wider than of 95 %, holds the parameter of the simulated machine."""
    report, _ = found
    estimates = {e.name: e for r in report.data["results"] for e in r["estimates"]}
    edges, ways = ("P-A", "A-T", "P-B", "B-T"), ("out", "in")
    expected = {f"{j} {e}": TRUE[f"drives.{j}_valve_area"] for j in ("boom", "slew") for e in edges}
    expected |= {f"boom dead band {way}": TRUE["drives.boom_valve_dead_band"] for way in ways}
    expected["boom leakage past the seals"] = TRUE["drives.boom_seal_conductance"]
    expected["manipulator.boom_mass"] = TRUE["manipulator.boom_mass"]
    assert not report.data["missing"]
    for name, value in expected.items():
        sd = estimates[name].sd
        # noise of the sensors: 3.5 standard deviations, exceeded once in 2000
        assert estimates[name].value == pytest.approx(value, abs=3.5 * sd), name
        # the file is off by 13 to 25 %, so the interval of what it does not tell would be as wide
        assert sd < 0.02 * value, name


def test_the_machine_is_built_with_the_keys(found, described, tmp_path):
    """`build --parameters` takes what was found, and the valve opens as that of the simulated machine."""
    report, file = found
    parts = crane_build(described, file).machine.subsystems
    own = {n: x.value for part in parts.values() for n, x in numbers(part)["parameters"].items()}
    # noise of the sensors, 0.1 %, and of the law, 0.1 %: at most half a percent
    assert own["boom_valve_area"] == pytest.approx(TRUE["drives.boom_valve_area"], rel=5e-3)
    assert own["boom_valve_pb_opening_4"] == pytest.approx(1.0, abs=5e-3)
    assert own["boom_valve_pb_command_1"] == pytest.approx(0.75, rel=1e-2)
    assert own["boom_mass"] == pytest.approx(TRUE["manipulator.boom_mass"], rel=0.02)
    page, _ = report.write(tmp_path / "page.html")
    assert "Boom: edges of its valve" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(("told", "area"), [("A-T", 1.5e-5), ("P-B", 3e-5)])
def test_edges_that_the_log_does_not_tell_keep_their_areas(tmp_path, told, area):
    """Also if the widest edge of the file is another one than of the log."""
    file, out = tmp_path / "edges.toml", tmp_path / "found.toml"
    edges = 'valve = "20 mm2", head_return = "25 mm2", rod_valve = "22 mm2"'
    file.write_text(FILE.replace('valve = "20 mm2"', edges), encoding="utf-8")
    crane = Crane(read(file))
    boom = next(f for f in crane.functions if f.joint == "boom")
    expected = {n: boom.start[f"boom {n}"][0] for n in EDGES} | {told: area}
    result = SimpleNamespace(estimates=[Estimate.normal(f"boom {told}", area, "m2", 1e-8, "")])
    write(out, {"parameters": keys(crane, [result])})
    parts = crane_build(crane.description, out).machine.subsystems
    p = {n: x.value for n, x in numbers(parts["drives"])["parameters"].items()}
    for edge, short in EDGES.items():
        opening = p[f"boom_valve_{short}_opening_4"] if p[f"boom_valve_{short}_command_2"] else 1.0
        assert p["boom_valve_area"] * opening == pytest.approx(expected[edge], rel=1e-9)  # rounding


def test_what_has_no_reading_is_said_in_a_line(described, simulated, tmp_path):
    """A function without one of its pressures has no estimates; the others have."""
    crane = Crane(described)
    results, missing = identify(crane, log(simulated, tmp_path, "boom_rod_pressure"))
    assert [r.procedure for r in results] == ["slew: valve and leakage"]
    assert missing[0] == "boom: valve and leakage: no reading of drives.boom_rod_pressure"
    assert "with readings of both pressures" in missing[1]
    assert {n.partition("_")[0] for n in keys(crane, results)} == {"slew"}


def test_friction_that_is_structure_is_no_unknown(tmp_path):
    """A cylinder without viscous friction in the file has masses and dry friction as unknowns."""
    file = tmp_path / "smooth.toml"
    file.write_text(FILE.replace('friction = "400 N"', "damping = 0"), encoding="utf-8")
    unknowns = Crane(read(file)).masses.start(None)
    assert "boom dry friction" in unknowns
    assert not any("damping" in n for n in unknowns)


def test_a_log_of_something_else_is_refused(described, tmp_path):
    """One line names the columns that are expected."""
    (tmp_path / "other.csv").write_text("time,x\n0,1\n1,2\n", encoding="utf-8")
    with pytest.raises(Problem, match=r"other.csv: expected columns such as boom_angle, .*, got none"):
        identify(Crane(described), tmp_path / "other.csv")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("boom_angle [deg]", "boom_angle [mm]", "signal manipulator.boom_angle is in m, expected rad"),
        ("boom_command [V]", "boom_command [%]", "signal drives.boom_command is in 1, expected V"),
    ],
)
def test_another_unit_is_refused(described, simulated, tmp_path, old, new, told):
    """A column in a unit of another quantity is named, instead of a search that does not converge."""
    path = log(simulated, tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(Problem, match=re.escape(told)):
        identify(Crane(described), path)


def test_a_log_too_short_for_the_filters_is_named(described, simulated, tmp_path):
    """It tells nothing, and the fit of the others would not converge with it."""
    path = log({n: x[:12] for n, x in simulated.items()}, tmp_path)
    with pytest.raises(Problem, match=r"log.csv: 12 samples, expected 39 or more for the filters"):
        identify(Crane(described), path)


def test_areas_of_another_kind_of_valve_are_refused(described, simulated, tmp_path):
    """A flow that grows with the square of the command leaves residuals far above the noise: no areas."""
    command, crane = simulated["boom_command"], Crane(described)
    other = simulated | {"boom_command": np.sign(command) * np.sqrt(5 * np.abs(command))}
    with pytest.raises(Contradicted, match="times the noise, expected 5 at most: another kind of valve"):
        solve(crane.functions[1].procedure, crane.read(log(other, tmp_path)), crane.known)


@pytest.mark.parametrize(("taken", "rest", "told"), [(-0.03, -4e-4, "30 ms"), (0.0, -0.012, "12 ms")])
def test_a_lag_of_the_spool_is_named(described, taken, rest, told):
    """By the delay with which the fit is best: a command that acts later than it was logged."""
    samples, late = [SimpleNamespace(rate=100.0)], ["drives.boom_command"]
    best = type("Best", (dict,), {"times_noise": 12.0})({delay_of(late): rest})
    fit = Fit(None, (), SimpleNamespace(fit=best, samples=samples), (), late, taken)
    with pytest.raises(Contradicted, match=f"12 times the noise, .* with a lag of about {told}, which"):
        Crane(described).functions[1].procedure.check(fit)


@pytest.mark.parametrize("ripple", [6e3, -6e3])
def test_pressures_that_follow_the_command_do_not_change_a_mass(described, simulated, tmp_path, ripple):
    """A pressure that grows with the rate of the command [Pa.s/V] is told from the weight; masses stay."""
    rate = np.gradient(simulated["boom_command"], simulated["time"])
    head = simulated["drives.boom_head_pressure"] + ripple * rate
    crane = Crane(described)
    logs = crane.read(log(simulated | {"drives.boom_head_pressure": head}, tmp_path))
    fit = fit_of(crane.masses, logs, crane.known)
    # noise of the sensors: 3.5 standard deviations; areas by hand, a gradient over two samples
    for name, expected in (
        ("manipulator.boom_mass", TRUE["manipulator.boom_mass"]),
        ("boom force per rate of the command", ripple * np.pi / 4 * 0.08**2),
    ):
        assert fit[name] == pytest.approx(expected, abs=3.5 * fit.sd(name)), name
    assert fit.sd("manipulator.boom_mass") < 0.02 * fit["manipulator.boom_mass"]


def test_rounded_readings_have_an_error(described, simulated, tmp_path):
    """Readings in steps of 1 bar and 0.1 degree at 50 Hz, without a description, tell the mass."""
    path = log({n: x[::2] for n, x in simulated.items()}, tmp_path, places={"[deg]": 1, "[bar]": 0})
    results, missing = identify(Crane(described), path)
    mass = next(e for r in results for e in r.estimates if e.name == "manipulator.boom_mass")
    assert not missing
    assert mass.value == pytest.approx(TRUE["manipulator.boom_mass"], abs=3.5 * mass.sd)
    assert mass.sd < 0.02 * mass.value  # as that of the log without steps


def test_a_joint_that_hangs_may_have_a_reading(tmp_path):
    """Its angle is that of the log; without a reading it hangs at rest."""
    hook = """
[hook]
axis = "-y"
at = ["3 m", 0, 0]
mass = "80 kg"
centre = [0, 0, "-1 m"]
inertia = [2, 2, 1]
[payload]
on = "hook"
at = [0, 0, "-1 m"]
"""
    file, path = tmp_path / "hook.toml", tmp_path / "log.csv"
    file.write_text(
        FILE.replace(FILE[FILE.index("[payload]") : FILE.index("[start]")], hook), encoding="utf-8"
    )
    time, crane = np.arange(50) / 100, Crane(read(file))
    columns = {"time [s]": time, "slew_angle [deg]": 0 * time, "boom_angle [deg]": 10 * time}
    for own, expected in ({"hook_angle [deg]": 30 * time}, 30 * time), ({}, -10 * time):
        table = columns | own
        np.savetxt(path, np.array([*table.values()]).T, delimiter=",", header=",".join(table), comments="")
        # below the last digit of the file; the second angle is that of the balance
        np.testing.assert_allclose(
            crane.read(path)[0]["manipulator.hook_angle"], np.deg2rad(expected), atol=1e-9
        )


def _at_rest(y, noisy):
    """All readings as at the start; the noise of the log is added, or none."""
    still = {n: np.full_like(x, x[0]) for n, x in y.items()}
    return still | {"time": y["time"]} | ({} if noisy else {"boom_command": y["boom_command"]})


POOR = {
    "constant": (
        _at_rest,
        False,
        {"[deg]": 3, "[bar]": 1},
        "22 s: nothing moves, slew_angle, boom_angle are",
    ),
    "noise": (_at_rest, True, None, "22 s: nothing moves, slew_angle, boom_angle are constant but for noise"),
    "half a second": (lambda y, _: {n: x[:50] for n, x in y.items()}, 0, None, "0.49 s, too short: nothing"),
}


@pytest.mark.parametrize(("change", "noisy", "places", "told"), POOR.values(), ids=POOR)
def test_a_log_without_motion_is_told_before_a_fit(
    described, simulated, tmp_path, monkeypatch, change, noisy, places, told
):
    """Frozen, at rest, or too short: what moves not, and what to record; a fit would take minutes."""
    monkeypatch.setattr("fmus.identification.crane.solve", None)
    path = log(change(simulated, noisy), tmp_path, places=places)
    with pytest.raises(Problem, match=re.escape(f"log.csv: {told}")) as caught:
        run(described, path, tmp_path / "found.toml")
    assert "record 20 s or more: each function out and in" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "rows", "value", "count"),
    [
        ("boom_head_pressure [bar]", slice(None), 1e308, 2201),
        ("boom_head_pressure [Pa]", slice(None), -1e308, 2201),
        ("boom_angle [deg]", slice(50, 53), 1e200, 3),
        ("slew_command [V]", slice(700, 701), -3e38, 1),  # the largest of a float
    ],
)
def test_what_no_sensor_reads_is_a_gap(described, simulated, tmp_path, capsys, name, rows, value, count):
    """Before anything is computed, so that nothing overflows (warnings are errors), and in one line."""
    path = log(simulated, tmp_path)
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    column = [n.partition(" ")[0] for n in header.split(",")].index(name.partition(" ")[0])
    table = [line.split(",") for line in lines]
    for row in table[rows]:
        row[column] = repr(value)
    names = header.split(",")
    names[column] = name
    path.write_text("\n".join(map(",".join, [names, *table])), encoding="utf-8")
    (read_log,) = Crane(described).read(path)
    (signal,) = (n for n in read_log.signals if n.endswith(name.partition(" ")[0]))
    assert np.count_nonzero(np.isnan(read_log[signal])) == count
    (line,) = (x for x in capsys.readouterr().err.splitlines() if "left out" in x)
    assert f"{signal}: {count} of 2201 samples left out, up to " in line


REASONS = {  # what a procedure raises, whether all is well, and whether the estimates are doubtful
    "no motion": (NotAsked("at rest"), True, False),
    "contradicted": (Contradicted("residuals of 9 times the noise"), False, False),
    "no convergence": (Problem("the fit did not converge, with 3 times the noise"), False, True),
}


@pytest.mark.parametrize(("reason", "passed", "doubtful"), REASONS.values(), ids=REASONS)
def test_a_procedure_without_a_result_is_a_state(
    described, simulated, tmp_path, monkeypatch, reason, passed, doubtful
):
    """Not the words of its line: what a log did not ask for is no failure, what it asked for is."""
    told = [Estimate.normal(n, 1.0, "1", 0.1, "") for n in Crane(described).functions[1].start]

    def solved(declared, *_):
        if not declared.name.startswith("boom"):
            raise reason
        return ProcedureResult(declared.name, "", 0, tuple(told), (), (), (), ())

    monkeypatch.setattr("fmus.identification.crane.solve", solved)
    report = run(described, log(simulated, tmp_path), tmp_path / "found.toml")
    assert (report.passed, report.data["doubtful"]) == (passed, doubtful)
    assert ("doubtful by the law that does not hold; harvester build" in report.verdict) == (
        type(reason) is Contradicted
    )
    del told[3:]
    report = run(described, log(simulated, tmp_path), tmp_path / "found.toml")
    asked = 8 if doubtful is False else 17
    assert report.verdict.startswith(f"{tmp_path / 'log.csv'}: 22 s: 3 of {asked} quantities of functions")
    assert (report.passed, report.data["doubtful"]) == (False, True)


def test_parameters_are_not_written_over_another_file(described, simulated, tmp_path):
    """The description of the crane, or of a log, stays as it is."""
    with pytest.raises(Problem, match=r"hook.toml: expected no file or one of parameters"):
        run(described, log(simulated, tmp_path), described.file)
    assert described.file.read_text(encoding="utf-8") == FILE


def test_check_tells_what_no_log_can(described):
    """Nothing but its own motor moves the column: `check` says so."""
    assert "note: identify cannot tell slew_mass: no cylinder carries it" in told_of(described)
