"""`harvester convergence` on the two-mass oscillator: orders, what is unstable, references, mistakes."""

import csv
import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import problem, refused, table

from orchestrator import Trace, assemble, run, write_trace
from orchestrator.__main__ import main
from orchestrator.data.recording import read_recording
from orchestrator.pages.plotting import draw
from orchestrator.ssp.coupling import Coupling
from orchestrator.studies.convergence.convergence_report import (
    OWN_STEPS,
    UNSTABLE,
    error_table,
    failures,
    figure,
    report,
)
from orchestrator.studies.convergence.convergence_study import (
    SETTINGS,
    ConvergenceStudy,
    as_reference,
    choose,
    finest_run,
    rate_inputs,
    run_as_reference,
    run_settings,
)

SSD = Path(__file__).with_suffix(".ssd").read_text(encoding="utf-8")  # the oscillator
META = Path(__file__).with_name("test_convergence_exact.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def truth(exact):
    """Its exact solution at every millisecond of a second."""
    time = np.arange(1001) * 1e-3
    x = exact(time)
    return run_as_reference("exact", Trace(time, {"a.x": x[:, 0], "b.x": x[:, 1]}, {"a.x": "m", "b.x": "m"}))


@pytest.fixture
def folder(tmp_path, monkeypatch, moving, zip_ssp, exact):
    """A working directory: the oscillator, its exact solution every 20 ms, and one with an unknown signal."""
    monkeypatch.chdir(tmp_path)
    files = {f"resources/{name}.fmu": part.source.path for name, part in moving.components.items()}
    zip_ssp(SSD, files, "two.ssp")
    time = np.arange(31) * 0.02
    x = exact(time)
    for name, signal in (("exact", "b.x"), ("other", "b.z")):
        write_trace(Trace(time, {"a.x": x[:, 0], signal: x[:, 1]}), f"{name}.csv")
        Path(f"{name}.toml").write_text(META.replace("b.x", signal))
    return tmp_path


def numbers():
    """What the command wrote."""
    return json.loads(Path("build/convergence/convergence.json").read_text())


@pytest.mark.parametrize(("label", "expected"), [("jacobi order 0", 1), ("gauss-seidel order 2", 3)])
def test_orders_of_convergence(moving, truth, label, expected):
    """The order of a study is that of the master (test_orders.py has all of them), and the table shows it."""
    rows = tuple(run_settings(moving, truth, choose([label]), (2e-3, 4e-3), 1, stop=1.0))
    found = ConvergenceStudy(truth, rows)
    # at 0.13 rad of the fast oscillation per step the next term of the error expansion is felt
    assert found.order(rows[1], "position") == pytest.approx(expected, abs=0.2)
    (line,) = error_table(found, "position").rows
    assert line[0] == label
    assert float(line[2].split()[1]) == pytest.approx(expected, abs=0.2)  # the same, printed


def test_runs_that_leave_the_reference_are_unstable(moving, truth):
    """An error that grows beyond the range of the signal is reported as unstable instead of as a number."""
    rows = tuple(run_settings(moving, truth, choose(["jacobi order 2"]), (1e-3, 5e-2), 1, stop=1.0))
    found = ConvergenceStudy(truth, rows)
    assert [row.stable for row in rows] == [True, False]
    assert error_table(found, "position").rows[0][2] == UNSTABLE
    assert f"**{UNSTABLE}**" in error_table(found, "position").markdown()
    (failure,) = failures(found)
    assert failure.startswith("jacobi order 2: unstable at 50 ms: completed, but")
    assert found.order(rows[1], "position") is None


def test_runs_that_fail_are_rows(fmus):
    """A step that fails ends its run only; the reason is kept."""
    system = assemble({"s": fmus["source"], "f": fmus["fails"]}, ["s.y -> f.u"], {"f.how": 3, "f.when": 0.5})
    sine = run_as_reference("sine", Trace(np.arange(101) * 0.01, {"s.y": np.sin(np.arange(101) * 0.01)}))
    chosen = choose(["jacobi order 0", "gauss-seidel order 0"])
    rows = tuple(run_settings(system, sine, chosen, (0.01,), stop=1.0))
    assert [row.stable for row in rows] == [False, False]
    assert [row.simulated for row in rows] == [pytest.approx(0.5)] * 2  # rounding of 50 steps
    assert all("the pump broke" in line for line in failures(ConvergenceStudy(sine, rows)))
    assert len(rows[0].walls) == 1  # nobody wants to know how long it takes to fail


def test_a_master_that_the_fmus_do_not_support_is_a_row(fmus):
    """A master that the FMUs do not support is a row; if nothing runs at all, the user made a mistake."""
    stuck = fmus.make("drift", "stuck", able={"canHandleVariableCommunicationStepSize": "false"})
    system = assemble({"s": fmus["source"], "d": stuck}, ["s.y -> d.u"])
    time = np.arange(101) * 0.01
    ramp = run_as_reference("ramp", Trace(time, {"d.y": 1 - np.cos(time)}))
    chosen = choose(["jacobi order 0", "hermite adaptive"])
    first, *others = run_settings(system, ramp, chosen, (1e-2,), 1, stop=1.0)
    assert not first.refusal
    assert len(others) == 4
    (failure,) = failures(ConvergenceStudy(ramp, tuple(others)))
    assert failure.startswith("hermite adaptive: not possible: adaptive steps: expected FMUs with"), failure
    problem(
        lambda: run_settings(system, ramp, chosen[1:], (1e-2,), 1, stop=1.0),
        others[0].refusal,
    )


def test_adaptive_settings_have_a_column_of_their_own(moving, truth):
    """A row for each tolerance with its error and mean step; without them there is no such column."""
    chosen = choose(["hermite adaptive", "jacobi order 0"])
    found = ConvergenceStudy(truth, tuple(run_settings(moving, truth, chosen, (5e-3,), 1, stop=1.0)))
    table = error_table(found, "position")
    assert table.head[-1] == OWN_STEPS
    assert [line[0] for line in table.rows[1:]] == [f"hermite adaptive 1e-0{n}" for n in range(2, 6)]
    runs = [row for row in found.runs if row.setting.adaptive]
    for line, row in zip(table.rows[1:], runs, strict=True):
        assert line[1:-1] == ("",)
        assert line[-1].endswith(f" at {1e3 * row.simulated / row.steps:.3g} ms")
    assert table.rows[0][1] != ""
    assert [row.error("position") for row in runs] == sorted(
        (r.error("position") for r in runs), reverse=True
    )
    others = ConvergenceStudy(truth, tuple(r for r in found.runs if r not in runs))
    assert error_table(others, "position").head == ["master", "5 ms"]


def test_instants_between_the_samples_of_a_reference_do_not_count(folder, moving):
    """Steps of 3 ms meet samples every 20 ms at each 60 ms; the error is that of these instants alone."""
    reference = as_reference(read_recording(folder / "exact.csv"))
    (row,) = run_settings(moving, reference, choose(["jacobi order 0"]), (3e-3,), 1, stop=0.6)
    trace = run(moving, master="jacobi", step=3e-3, stop=0.6).trace
    every = reference["a.x"]
    apart = trace["a.x"][::20] - every[::3]
    share = np.sqrt(np.mean(apart**2)) / np.ptp(every)
    found = row.errors["a.x"].metrics.nrmse
    assert found == pytest.approx(share, rel=1e-9)  # same numbers but for their digits in the file


def test_the_worst_signal_counts(moving, truth):
    """The error of a group is that of its worst signal, over the range of the truth, in any unit."""
    (row,) = run_settings(moving, truth, choose(["jacobi order 0"]), (1e-2,), 1, stop=1.0)
    trace = run(moving, master="jacobi", step=1e-2, stop=1.0).trace
    shares = []
    for name, values in truth.items():
        apart = trace[name] - values[::10]
        shares.append(np.sqrt(np.mean(apart**2)) / np.ptp(values))
    assert row.error("position") == pytest.approx(max(shares), rel=1e-12)  # rounding
    signals = {name: 1e3 * values for name, values in truth.items()}
    small = run_as_reference("exact", Trace(truth.time, signals, dict.fromkeys(signals, "mm")))
    (same,) = run_settings(moving, small, choose(["jacobi order 0"]), (1e-2,), 1, stop=1.0)
    assert same.error("position") == pytest.approx(row.error("position"), rel=1e-9)  # rounding


def test_signals_at_rest_are_left_out():
    """What moves a millionth of what others of its unit do has no range to compare with."""
    time = np.linspace(0, 1, 11)
    signals = {"a.x": np.sin(time), "a.y": 1e-7 * np.sin(time)}
    found = run_as_reference("run", Trace(time, signals, dict.fromkeys(signals, "m")))
    assert [*found] == ["a.x"]
    assert found.metadata["not compared, at rest"] == "a.y"


def test_plain_settings_leave_out_rate_connections(fmus):
    """A plain master gets the system without the connections of rate ports."""
    slope = fmus.make("source", "slope_source", units={"y": "m/s"})
    files = {"s": fmus["source"], "r": slope, "d": fmus["drift"]}
    system = assemble(files, ["s.y -> d.u", "r.y -> d.u_rate"])
    assert rate_inputs(system) == ("d.u_rate",)
    time = np.arange(101) * 0.01
    ramp = run_as_reference("sum", Trace(time, {"d.y": 1 - np.cos(time)}))
    chosen = choose(["jacobi plain", "jacobi order 0"])
    plain, wired = run_settings(system, ramp, chosen, (0.01,), 1, stop=1.0)
    lost = {row.setting.label: row.errors["d.y"].metrics.maximum_error for row in (plain, wired)}
    # held inputs lose h/2 sin t, and the rate, which is a sine too, adds h/2 (1 - cos t); the rest is h^2
    assert lost["jacobi plain"] == pytest.approx(0.5e-2 * np.sin(1), rel=2e-2)
    assert lost["jacobi order 0"] == pytest.approx(0.5e-2 * (np.sqrt(2) - 1), rel=2e-2)


@pytest.mark.usefixtures("folder")
def test_the_command_prints_and_writes(capsys):
    """It prints tables; the CSV has a row for each run, the JSON all signals; the page has two figures."""
    options = ["--reference", "exact.csv", "--steps", "0.01,0.005", "--masters", "jacobi", "--repeats", "2"]
    assert main(["convergence", "two.ssp", *options]) == 0
    printed = capsys.readouterr().out
    assert "position: worst NRMSE against exact" in printed
    assert "wall time per simulated second [ms]" in printed
    with Path("build/convergence/convergence.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    expected = [(f"jacobi order {order}", step) for order in range(3) for step in (0.005, 0.01)]
    assert [(line["setting"], float(line["step [s]"])) for line in lines] == expected
    found = numbers()
    assert found["groups"] == {"position": ["a.x", "b.x"]}
    assert len(found["runs"][0]["walls [s]"]) == 2
    order = found["runs"][1]["position order of convergence"]
    assert order == pytest.approx(1, abs=0.3)  # 0.33 rad of the fast oscillation per step
    page = Path("build/convergence/convergence.html").read_text(encoding="utf-8")
    assert page.count('<div class="plot"') == 2


@pytest.mark.usefixtures("folder")
def test_without_a_reference_the_finest_hermite_run_takes_its_place(capsys):
    """For the stop time and start values of the run; errors are about those against the exact solution."""
    options = ["two.ssp", "--steps", "0.01", "--masters", "jacobi order 0", "--signals", "*.x"]
    assert main(["convergence", *options]) == 0
    assert "no reference for this run: hermite at 5 ms, half the smallest step" in capsys.readouterr().out
    own = numbers()["runs"][0]["errors"]["a.x"]["nrmse"]
    assert main(["convergence", *options, "--reference", "exact.csv"]) == 0
    known = numbers()["runs"][0]["errors"]["a.x"]["nrmse"]
    # hermite at 5 ms is off by less than 1e-4 of the range, jacobi by 0.1; the instants differ
    assert own == pytest.approx(known, rel=0.1)
    assert main(["convergence", *options, "--stop", "0.3", "--set", "a.mass=2"]) == 0
    assert numbers()["reference"] == "hermite at 5 ms"
    assert numbers()["runs"][0]["simulated [s]"] == pytest.approx(0.3)  # rounding


@pytest.mark.usefixtures("folder")
def test_settings_that_are_all_unstable_have_tables_and_files(capsys):
    """The reasons, and no picture of nothing."""
    # jacobi of order 2 with 2 rad of the fast oscillation per step
    assert main(["convergence", "two.ssp", "--steps", "0.06", "--masters", "jacobi order 2"]) == 0
    assert "unstable at 60 ms" in capsys.readouterr().out
    assert [run["stable"] for run in numbers()["runs"]] == [False]


@pytest.mark.usefixtures("folder")
@table(__file__, "mistakes", "options, message")
def test_mistakes_are_one_line(capsys, options, message):
    """Exit status 2, and a line that names what was expected and found."""
    assert refused(capsys, ["convergence", "two.ssp", *options]).startswith(f"harvester: {message}")


def test_every_setting_has_a_name_of_its_own():
    """Rows, lines and cells are found by it."""
    labels = [setting.label for setting in SETTINGS]
    assert len(set(labels)) == len(labels)
    for master, order in product(("jacobi", "gauss-seidel"), range(3)):
        assert choose([f"{master} order {order}"])[0].coupling == Coupling(master, order)


def test_figures_label_every_curve(moving):
    """Each stable setting is in a label, also if several share a curve; unstable runs have a cross."""
    solution = finest_run(moving, ["b.x", "b.v"], (5e-2,), stop=1.0)
    rows = run_settings(moving, solution, choose(["jacobi", "hermite"]), (5e-3, 5e-2), 1, stop=1.0)
    found = ConvergenceStudy(solution, tuple(rows))
    for over_cost in (False, True):
        for panel in figure(found, over_cost=over_cost).panels:
            named = {line.key for line in panel.lines}
            assert {f"jacobi order {n}" for n in range(3)} | {"hermite to tolerance"} <= named
            assert (UNSTABLE in named) is not over_cost
    axes = draw(figure(found)).axes
    assert [text.get_text() for text in axes[-1].get_xticklabels()][:2] == ["5", "10"]


def test_runs_on_a_cluster_have_the_same_errors_and_no_times(moving, truth):
    """In the order of the plans, refused settings among them; the report has no costs."""
    from distributed import Client

    chosen = choose(["jacobi order 1", "hermite", "interface-jacobian"])
    here = run_settings(moving, truth, chosen, (5e-3, 1e-2), 1, stop=1.0)
    with Client(
        processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0"
    ) as client:
        there = run_settings(moving, truth, chosen, (5e-3, 1e-2), client=client, stop=1.0)
    for one, other in zip(here, there, strict=True):
        plain = [replace(run, walls=(), errors=None) for run in (one, other)]
        assert plain[0] == plain[1]
        assert [row.metrics for row in one.rows] == [row.metrics for row in other.rows]
    assert not any(run.walls for run in there)
    assert "wall time per simulated second" in report(ConvergenceStudy(truth, tuple(here))).text()
    assert "wall time" not in report(ConvergenceStudy(truth, tuple(there))).text()
