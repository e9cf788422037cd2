"""Fidelity: the example with its commands by hand, and the measures of docs/fidelity.md on known signals."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kit import shards
from kit.scripts import names_of

from benchmarks import held_out
from fmus.machine.parts import FAMILIES
from orchestrator import load, run
from orchestrator.__main__ import main
from orchestrator.data.recording import read_recording
from orchestrator.results.validation import validate

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "fidelity"
DOCUMENT = ROOT / "docs" / "fidelity.md"


@pytest.fixture(scope="module")
def measures() -> SimpleNamespace:
    """docs/fidelity_measures.py."""
    return SimpleNamespace(**names_of(DOCUMENT.with_name("fidelity_measures.py")))


def script(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The example run as its README says."""
    command = [sys.executable, str(EXAMPLE / "run.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@shards.documents
@pytest.mark.parametrize("part", ["boom_stick", "manipulator"])
def test_every_variant_has_a_line(fmu_dir, tmp_path, part):
    """Over 2 s: a line for each variant, one of them the reference, and errors of the others."""
    run = script(part, "--build", str(fmu_dir), "--stop", "2", "--out", str(tmp_path))
    assert run.returncode == 0, run.stderr
    lines = run.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:-1]] == list(FAMILIES[part])
    assert sum(line.endswith("the reference") for line in lines) == 1
    found = json.loads((tmp_path / "comparison.json").read_text(encoding="utf-8"))
    assert found["reference"] == {"boom_stick": "detailed", "manipulator": "pendulum_friction"}[part]
    errors = {n: r["signals"]["manipulator.boom_speed"] for n, r in found["runs"].items() if "signals" in r}
    assert set(errors) == set(FAMILIES[part]) - {found["reference"]}
    assert all(error["nrmse"] > 0 for error in errors.values())
    assert (tmp_path / "comparison.html").stat().st_size > 0


def test_a_folder_without_a_build_is_told_in_one_line(tmp_path):
    """The line names the file that is missing and the command that makes it."""
    run = script("--build", str(tmp_path))
    assert run.returncode == 1
    assert run.stderr == f"{tmp_path / 'harvester.ssp'} is not there: run `harvester build` first\n"


def test_ripple_parts_a_known_signal(measures):
    """Two sines on a parabola: each comes back with its RMS, the fast one with its frequency."""
    time = np.arange(0.0, 4.0, 1e-3)
    bar = 90 - 3 * time + 0.5 * time**2 + 2 * np.sin(2 * math.pi * 4 * time) + np.sin(2 * math.pi * time)
    found = measures.ripple(time, 1e5 * bar, 0.5, 3.5)
    # the window weighs the middle, and the parabola takes a little of the slow sine
    assert found.fast == pytest.approx(2 / math.sqrt(2), rel=0.02)
    assert found.slow == pytest.approx(1 / math.sqrt(2), rel=0.1)
    assert found.peak == pytest.approx(4, abs=0.05)


def test_modes_of_two_known_oscillators(measures):
    """Frequency, damping ratio and the states that move, also with damping."""
    matrix, kinds = np.zeros((4, 4)), {"slow": (0.5, 0.1), "fast": (30.0, 0.7)}
    for n, (frequency, damping) in enumerate(kinds.values()):
        w = 2 * math.pi * frequency
        matrix[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] = [[0, 1], [-(w**2), -2 * damping * w]]
    found = measures._modes(matrix, ["slow.x", "slow.v", "fast.x", "fast.v"])
    for name, (frequency, damping) in kinds.items():
        mode = measures.mode_of(found, name)
        assert mode.frequency == pytest.approx(frequency, rel=1e-9)
        assert mode.damping == pytest.approx(damping, rel=1e-9)


def test_every_table_of_the_document_is_filled():
    """docs/fidelity.py has a place for each table; each row is as long as the head and has a number."""
    text = DOCUMENT.read_text(encoding="utf-8")
    script = DOCUMENT.with_suffix(".py").read_text(encoding="utf-8")
    places = dict(re.findall(r"<!-- (.*?) -->\n(.*?)\n<!-- end -->", text, re.DOTALL))
    assert set(places) == set(re.findall(r'fill\(DOCUMENT, "(.*?)"', script))
    for name, table in places.items():
        head, _, *rows = (line.split("|")[1:-1] for line in table.splitlines() if line.startswith("|"))
        assert len(rows) > 1, name
        assert {len(row) for row in rows} == {len(head)}, name
        assert all(re.search(r"\d", " ".join(row[1:])) for row in rows), name


# ---- Numbers in sentences of README and docs are those of the command, script or table that computes them


def told(page, pattern):
    """The numbers that a sentence tells."""
    found = re.search(pattern, (ROOT / page).read_text(encoding="utf-8"))
    assert found, f"{page}: no {pattern}"
    return [float(number) for number in found.groups()]


def test_readme_counts_the_numbers_of_the_machine(tmp_path, monkeypatch, capsys):
    """As `harvester parameters` does without FMUs that somebody built with other numbers."""
    monkeypatch.chdir(tmp_path)
    assert main(["parameters"]) == 0
    counted = re.search(r"^(\d+) numbers: (\d+) paper", capsys.readouterr().out, re.MULTILINE)
    assert [*map(float, counted.groups())] == told("README.md", r"has (\d+) numbers\. (\d+) of them")


def test_the_table_of_held_out_machines_is_that_of_their_results():
    """Of docs/held-out.jsonl, which `python -m benchmarks.held_out` writes."""
    page = (ROOT / "docs/coupling.md").read_text(encoding="utf-8")
    assert f"{held_out.MARKS[0]}{held_out.table(held_out.read(held_out.RESULTS))}\n" in page


def test_a_case_of_the_held_out_machines_runs(built, monkeypatch):
    """Each measure of a short case of the tuning's seed is a number, and the accuracy is reached."""
    loop = held_out.simulation_loop
    monkeypatch.setattr(loop, "time", loop.time)  # it counts processor time
    found = held_out.outcome(held_out.TUNING, 7, built, with_cost=False)
    assert not found.why
    assert 0.0 < found.error <= found.asked
    assert all(number > 0 for number in (found.estimate, found.cpu, found.runs, found.steps))


def test_readme_tells_how_near_the_tip_stays():
    """The largest errors with feedback in docs/control.md, which is run, rounded up to millimetres."""
    page = (ROOT / "docs/control.md").read_text()
    rows = re.findall(r"^\w+ +(lumped|detailed) +yes +([\d.]+)", page, re.MULTILINE)
    largest = {machine: max(float(error) for m, error in rows if m == machine) for machine, _ in rows}
    lumped, detailed = told("README.md", r"within (\d+) mm; detailed drives: (\d+) mm")
    assert 0 <= lumped - largest["lumped"] < 1
    assert 0 <= detailed - largest["detailed"] < 1


@shards.documents
def test_readme_tells_the_error_with_rate_ports(built):
    """A plain Jacobi master at 1 ms over the work cycle: the worst joint speed, against the reference."""
    reference = read_recording(ROOT / "data/reference/work_cycle.csv")
    system, scenario = load(built / "harvester.ssp"), ROOT / "data/scenarios/work_cycle.csv"
    outcome = validate(run(system, scenario, master="jacobi", step=1e-3), reference)
    errors = [outcome[f"manipulator.{joint}_speed"].metrics.nrmse for joint in ("swing", "boom", "stick")]
    (percent,) = told("README.md", r"at 1 ms has an error of at most ([\d.]+) %")
    # of the last digit; other compilers round otherwise
    assert abs(100 * max(errors) - percent) < 1.5e-4


@shards.documents
def test_the_equations_tell_the_numbers_of_the_opening_curve(monkeypatch, tmp_path, capsys):
    """The share of the range where the polynomial is negative, and the error of that of the logarithm."""
    script = names_of(ROOT / "docs/opening_curve.py")
    monkeypatch.setitem(script["main"].__globals__, "IMAGE", tmp_path / "curve.png")
    script["main"]()
    printed = capsys.readouterr().out
    negative = re.search(r"^polynomial of degree (\d+):.* (\d+)% negative", printed, re.MULTILINE)
    ratio = re.search(r"^ln C_R.* by ([\d.]+) to ([\d.]+) of", printed, re.MULTILINE)
    shown = told("docs/equations.md", r"of degree (\d+).* on (\d+) % of that")
    assert [*map(float, negative.groups())] == shown
    error = max(abs(1 - float(value)) for value in ratio.groups())
    assert [round(100 * error)] == told("docs/equations.md", r"errs by up to (\d+) %")


def rows(page, head):
    """The numbers of the table with this head, row by row."""
    table = (ROOT / page).read_text(encoding="utf-8").split(f"\n{head}\n")[1].split("\n\n")[0].splitlines()
    return [[float(cell) for cell in re.findall(r"[-\d.]+(?=[\s|,°])", row)] for row in table[1:]]


def test_the_equations_tell_the_viscosity_and_the_efficiency_of_a_pump():
    """Walther's law through both points of the grade; docs/pump_efficiency.py."""
    viscosity, ratio, winter = rows("docs/equations.md", "|°C|-20|0|20|40|60|80|")

    def walther(celsius, at_100=6.8):
        logs = [math.log10(math.log10(nu + 0.7)) for nu in (46.0, at_100)]
        slope = (logs[1] - logs[0]) / math.log10(373.15 / 313.15)
        return 10**10 ** (logs[0] + slope * math.log10((celsius + 273.15) / 313.15)) - 0.7

    usual = walther(60)
    for celsius, nu, m, cold in zip(range(-20, 81, 20), viscosity, ratio, winter, strict=True):
        assert nu == pytest.approx(walther(celsius), rel=5e-3)  # three digits
        assert cold == pytest.approx(walther(celsius, 8.2), rel=5e-3)
        density = 1 / (1 + 7e-4 * (celsius - 60))
        assert m == pytest.approx(walther(celsius) / usual * density, rel=5e-3)
    script = names_of(ROOT / "docs/pump_efficiency.py")
    table = rows("docs/equations.md", "|oil, pressure, stroke|model|measured pump|")
    for celsius, bar, stroke, *shown in table:
        point = (np.array([bar * 1e5]), np.array([stroke]), celsius)
        assert shown == pytest.approx([script[n](*point)[0] for n in ("ours", "measured")], abs=5.1e-4)


@shards.documents
def test_the_equations_tell_the_power_of_lowering_the_boom(built):
    """Supply, pilot, power and oscillation of the shipped edge, as docs/counterbalance.py prints them."""
    script = names_of(ROOT / "docs/counterbalance.py")
    system = str(built / "harvester.ssp")
    supply, pilot, watts = script["power"](script["lowered"](1.5, script["WIDE"], 10.0, 2.2, system))
    slow = script["lowered"](1.5, script["WIDE"], 2.5, 4.5, system)
    ripples = (100 * script["ripple"](slow, start, start + 1) for start in (1.0, 3.5))
    numbers = r"\|66 mm2\|1\.5\|(\d+) bar\|(\d+) bar\|(\d+) kW\|([\d.]+)%\|([\d.]+)%"
    found = (supply / 1e5, pilot / 1e5, watts / 1e3, *ripples)
    # of the last digit; other compilers round otherwise
    assert all(abs(a - b) < 1 for a, b in zip(found, told("docs/equations.md", numbers), strict=True))


@shards.documents
def test_the_page_on_control_tells_the_errors_of_the_load_sensing_machine(built, tmp_path):
    """The row of the heaviest head, in tenths of a millimetre."""
    swaps = [f"--swap={p}" for p in ("swing=compensated", "boom_stick=compensated", "supply=load_sensing")]
    ideal = ["--set=valve_actuation.hysteresis=0", "--set=controller.hysteresis=0"]
    arguments = [*swaps, *ideal, "--no-compare", "--set=manipulator.head_mass=900", "--out", str(tmp_path)]
    assert main(["track", str(built / "harvester_control.ssp"), *arguments]) == 0
    runs = json.loads((tmp_path / "tracking.json").read_text())["runs"]
    found = [1e3 * r[f"{kind} error [m]"] for r in runs for kind in ("largest", "RMS")]
    row = r"\|900 kg\|([\d.]+), ([\d.]+)\|[^|]*\|([\d.]+), ([\d.]+)\|"
    assert all(abs(a - b) < 0.11 for a, b in zip(found, told("docs/control.md", row), strict=True))
