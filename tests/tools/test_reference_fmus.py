"""The Reference-FMUs of the Modelica Association: their shipped results, bit for bit, in Co-Simulation.

They are in no package of a registry, so these tests need a folder with their sources, at a commit of 2026:
REFERENCE_FMUS=/path/to/Reference-FMUs.
"""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from kit.any_fmu.description import member, packed
from kit.mistakes import problem

from orchestrator import load, run
from orchestrator.base.compiler import PLATFORMS, SUFFIX, host, shared_library

ROOT = Path(os.environ.get("REFERENCE_FMUS", "/none"))
pytestmark = pytest.mark.skipif(not ROOT.is_dir(), reason="REFERENCE_FMUS names no folder with their sources")
WORDS = {"true": "1", "false": "0"}
MODELS = ["BouncingBall", "Dahlquist", "Feedthrough", "Resource", "Stair", "VanDerPol"]


def built(model: str, version: int, folder: Path) -> Path:
    """An FMU from its sources."""
    parts = [f"fmi{version}Functions.c", "model.c", "cosimulation.c"]
    code = f"#define FMI_VERSION {version}\n" + "".join(f'#include "{name}"\n' for name in parts)
    flags = ["-target", PLATFORMS[host()].target, "-O1", "-shared", "-fPIC", "-w", "-std=c99", "all.c", "-lm"]
    flags += [f"-I{ROOT / place}" for place in (model, "include", "src")]
    flags += [f"-DFMI{version}_OVERRIDE_FUNCTION_PREFIX", "-DDISABLE_PREFIX", "-D_GNU_SOURCE"]
    library = shared_library(f"{model}{version}{SUFFIX}", {"all.c": code.encode()}, flags)
    files = {"modelDescription.xml": (ROOT / model / f"FMI{version}.xml").read_text("utf-8")}
    files |= {member(version, model): library.read_bytes()}
    if (text := ROOT / model / "y.txt").exists():
        files["resources/y.txt"] = text.read_bytes()
    return packed(folder / "r.fmu", files)


@pytest.mark.parametrize(
    ("model", "version"), [*((m, v) for m in MODELS for v in (2, 3)), ("StateSpace", 3)], ids=str
)
def test_the_shipped_results_are_those_of_a_run(tmp_path, model, version):
    """Each column that the FMU of this version has, in FMI 3 all of them; texts are those of the start."""
    names, *rows = csv.reader((ROOT / model / f"{model}_out.csv").read_text("utf-8").splitlines())
    time = [float(row[0]) for row in rows]
    fmu = load(built(model, version, tmp_path))
    known = fmu.components["r"].interface.variables.keys() | fmu.components["r"].interface.arrays.keys()
    result = run(fmu, stop=time[-1], step=round(time[1] - time[0], 9))
    np.testing.assert_allclose(result.time, time, atol=1e-9)  # of the file, which has sums of steps
    assert version == 2 or known.issuperset(names[1:])
    for column, name in enumerate(names[1:], 1):
        found = [s for s in result if s == f"r.{name}" or s.startswith(f"r.{name}[")]
        exact = [[WORDS.get(text, text) for text in row[column].split()] for row in rows if found]
        for signal, values in zip(found, np.transpose(np.array(exact, float)), strict=True):
            np.testing.assert_array_equal(result[signal], values, signal)
        texts = {text for _, signal, text in result.texts if signal == f"r.{name}"}
        assert found or texts == {row[column] for row in rows if name in known}, name


def test_clocks_is_of_scheduled_execution(tmp_path):
    """The message says so."""
    told = problem(lambda: load(built("Clocks", 3, tmp_path)))
    assert told.endswith("or model exchange, got one for scheduled execution only")
