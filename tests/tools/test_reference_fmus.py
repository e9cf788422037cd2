"""The Reference-FMUs of the Modelica Association: their shipped results, bit for bit, in Co-Simulation.

The shipped results are those of Euler's method. So in Model Exchange models with states are compared with
their exact solutions, the others with the shipped results. `Roberts` ships the results of BouncingBall.

They are in no package of a registry, so these tests need a folder with their sources, at a commit of 2026:
REFERENCE_FMUS=/path/to/Reference-FMUs.
"""

import csv
import re
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from kit.any_fmu.description import member, packed
from kit.mistakes import problem
from kit.needs import REFERENCE_FMUS, needs
from scipy.integrate import solve_ivp

from orchestrator import load, reference, run
from orchestrator.base.compiler import PLATFORMS, SUFFIX, host, shared_library

pytestmark = needs("Reference-FMUs", "REFERENCE_FMUS names no folder with their sources")
WORDS = {"true": "1", "false": "0"}
MODELS = ["BouncingBall", "Dahlquist", "Feedthrough", "Resource", "Stair", "VanDerPol"]

EVERY = [*((m, v) for m in MODELS for v in (2, 3)), ("StateSpace", 3)]


def built(model: str, version: int, folder: Path, without: str = "") -> Path:
    """An FMU from its sources; without: a kind that it does not declare."""
    parts = [f"fmi{version}Functions.c", "model.c", "cosimulation.c"]
    code = f"#define FMI_VERSION {version}\n" + "".join(f'#include "{name}"\n' for name in parts)
    flags = ["-target", PLATFORMS[host()].target, "-O1", "-shared", "-fPIC", "-w", "-std=c99", "all.c", "-lm"]
    flags += [f"-I{REFERENCE_FMUS / place}" for place in (model, "include", "src")]
    flags += [f"-DFMI{version}_OVERRIDE_FUNCTION_PREFIX", "-DDISABLE_PREFIX", "-D_GNU_SOURCE"]
    library = shared_library(f"{model}{version}{SUFFIX}", {"all.c": code.encode()}, flags)
    xml = (REFERENCE_FMUS / model / f"FMI{version}.xml").read_text("utf-8")
    kind = rf"<{without}\b[^>]*?(/>|>.*?</{without}>)" if without else "(?!)"
    files = {"modelDescription.xml": re.sub(kind, "", xml, flags=re.DOTALL)}
    files |= {member(version, model): library.read_bytes()}
    if (text := REFERENCE_FMUS / model / "y.txt").exists():
        files["resources/y.txt"] = text.read_bytes()
    return packed(folder / "r.fmu", files)


def bounces(time):
    """Height [m] and speed [m/s] of a ball from 1 m that keeps 0.7 of its speed, below 0.1 m/s none."""
    height, speed, g = np.zeros_like(time), np.zeros_like(time), 9.81
    begin, first, up = 0.0, 1.0, 0.0  # time [s], height [m] and speed [m/s] after the last impact
    while True:
        impact = (up + sqrt(up**2 + 2.0 * g * first)) / g
        inside = (time >= begin) & (time < begin + impact)
        t = time[inside] - begin
        height[inside] = first + up * t - 0.5 * g * t**2
        speed[inside] = up - g * t
        begin, first, up = begin + impact, 0.0, 0.7 * (g * impact - up)
        if up < 0.1:
            return height, speed


def orbit(time):
    """Van der Pol's oscillator with mu = 1 from (2, 0), by another method at a tighter tolerance."""

    def rates(_t, x):
        return x[1], (1.0 - x[0] ** 2) * x[1] - x[0]

    return solve_ivp(rates, (0.0, time[-1]), [2.0, 0.0], "DOP853", time, rtol=1e-13, atol=1e-13).y


SOLVED = {  # model -> values over time of the columns that it ships
    "BouncingBall": bounces,
    "Dahlquist": lambda time: [np.exp(-time)],
    "StateSpace": lambda time: [np.outer([1.0, 2.0, 3.0], np.exp(time))],
    "VanDerPol": orbit,
}


def shipped(model: str) -> tuple[list[str], list[list[str]], list[float]]:
    """Names of the columns, rows, and times [s]."""
    names, *rows = csv.reader((REFERENCE_FMUS / model / f"{model}_out.csv").read_text("utf-8").splitlines())
    return names, rows, [float(row[0]) for row in rows]


@pytest.mark.parametrize(
    ("model", "version", "without"),
    [*((*one, "") for one in EVERY), *((*one, "CoSimulation") for one in EVERY if one[0] not in SOLVED)],
    ids=str,
)
def test_the_shipped_results_are_those_of_a_run(tmp_path, model, version, without):
    """Each column that the FMU of this version has, in FMI 3 all of them; texts are those of the start."""
    names, rows, time = shipped(model)
    fmu = load(built(model, version, tmp_path, without))
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


@pytest.mark.parametrize(("model", "version"), [one for one in EVERY if one[0] in SOLVED], ids=str)
def test_model_exchange_has_the_exact_solution(tmp_path, model, version):
    """As a component at the step of the shipped results, and as a monolithic reference."""
    names, _, time = shipped(model)
    fmu, step = load(built(model, version, tmp_path, "CoSimulation")), round(time[1] - time[0], 9)
    # The solver of a component has the tolerance 1e-8, that of the reference 2e-14. Errors of an orbit or of
    # times of impact grow from step to step by less than a hundred.
    for result, tolerance in (
        (run(fmu, stop=time[-1], step=step), 1e-6),
        (reference(fmu, stop=time[-1], record_step=step), 1e-10),
    ):
        exact = SOLVED[model](result.time)
        assert len(exact) == len(names) - 1
        for name, values in zip(names[1:], exact, strict=True):
            found = [s for s in result if s == f"r.{name}" or s.startswith(f"r.{name}[")]
            for signal, one in zip(found, np.atleast_2d(values), strict=True):
                np.testing.assert_allclose(result[signal], one, tolerance, tolerance, err_msg=signal)


def test_clocks_is_of_scheduled_execution(tmp_path):
    """The message says so."""
    told = problem(lambda: load(built("Clocks", 3, tmp_path)))
    assert told.endswith("or model exchange, got one for scheduled execution only")
