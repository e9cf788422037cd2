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

from fmus.machine.parts import FAMILIES

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
    assert (tmp_path / "comparison.png").stat().st_size > 0


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


def test_a_parabola_has_no_ripple(measures):
    """The trend of a pose that changes is no ripple."""
    time = np.arange(0.0, 2.0, 1e-3)
    found = measures.ripple(time, 1e5 * (90 - 3 * time + 0.5 * time**2), 0.5, 1.5)
    assert max(found.fast, found.slow) < 1e-9  # bar: rounding of 90 bar


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
