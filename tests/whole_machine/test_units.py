"""A value in the wrong unit gets one warning that proposes the right one; what is shipped gets none."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kit import shards
from kit.every import MACHINES

from orchestrator import load, read_trace
from orchestrator.__main__ import main
from orchestrator.base.errors import Problem
from orchestrator.base.units import doubt
from orchestrator.engine.run import prepare
from orchestrator.ssp.system import System

# the parameters that pages, examples and studies set most often; boom_stroke is shared by two components
MOST_USED = (
    *("manipulator.head_mass", "supply.pressure_setting", "swing.motor_displacement", "swing.valve_area"),
    *(
        "boom_stick.valve_area",
        "swing.valve_dead_band",
        "boom_stick.boom_bore",
        "boom_stick.boom_hose_length",
    ),
    *("boom_stick.bulk_modulus", "boom_stroke"),
)
COLUMNS = [
    (name, column)
    for name in ("boom_up", "line", "square", "work_cycle", "work_cycle_stems")
    for column, values in read_trace(name).signals.items()
    if values.any()  # zero is never doubtful
]


def warnings(system: System, *arguments, **options) -> tuple[str, ...]:
    """What a run would warn of before its first step."""
    return prepare(system, *arguments, isolate=False, **options)[0].system.warnings


@pytest.fixture(scope="module")
def systems(built):
    """The machine without and with the controller, which follows the paths of `line` and `square`."""
    machine, control = (load(built / f"{name}.ssp") for name in ("harvester", "harvester_control"))
    return {"line": control, "square": control, "": machine}


@pytest.mark.parametrize("factor", [1000, 0.001])
@pytest.mark.parametrize("name", MOST_USED)
def test_no_parameter_is_silently_off_by_1000(systems, name, factor):
    """It is refused by the limits of the FMU, or gets one warning that names it."""
    system = systems[""]
    port = system.targets(name)[0][0]
    value = factor * system.components[port.component].value(port.variable)
    try:
        (told,) = warnings(system, set={name: value})
    except Problem as refused:
        told = f"{refused}; is the unit right?"
    assert port.variable in told
    assert told.endswith("?")


@pytest.mark.parametrize(("scenario", "column"), COLUMNS)
def test_no_column_is_silently_off_by_1000(systems, scenario, column):
    """Nor is the time of a scenario in milliseconds; one warning each."""
    system, trace = systems.get(scenario, systems[""]), read_trace(scenario)
    for factor in (1000, 0.001):
        signals = {**trace.signals, column: factor * trace.signals[column]}
        (told,) = warnings(system, replace(trace, signals=signals))
        assert f"column {column} = " in told
    (told,) = warnings(system, replace(trace, time=1000 * trace.time))
    assert told.endswith("did you mean ms?")


@pytest.mark.parametrize(
    "machine", [{}, *(pytest.param(m, marks=shards.search) for m in MACHINES[1:])], ids=str
)
def test_nothing_shipped_is_doubtful(systems, machine):
    """No parameter set and no scenario, in any variant; zero in place of a parameter neither."""
    for name, system in systems.items():
        sets = [file.removesuffix(".ssv") for file in system.resources if file.endswith(".ssv")]
        used = {part: variant for part, variant in machine.items() if not (name and part == "manipulator")}
        assert warnings(system, swap=used, parameters=sets) == warnings(system, swap=used)
        for scenario in {s for s, _ in COLUMNS if systems.get(s, systems[""]) is system}:
            assert warnings(system, scenario, swap=used) == warnings(system, swap=used)
    assert warnings(systems[""], set={"swing.valve_dead_band": 0, "boom_stick.boom_hose_length": 0.5}) == ()


def test_the_warning_is_in_the_result_and_its_file(built, tmp_path, capsys):
    """Once, and the run goes on: the exit status is 0."""
    out = tmp_path / "run.csv"
    arguments = ["--set", "manipulator.head_mass=0.6", "--stop", "0.01", "--out", str(out)]
    assert main(["run", str(built / "harvester.ssp"), *arguments]) == 0
    told = "manipulator.head_mass = 0.6 kg, usually about 350 kg; did you mean 0.6 t?"
    assert capsys.readouterr().out.count(told) == 1
    assert json.loads(out.with_suffix(".run.json").read_text())["warnings"] == [told]


@pytest.mark.parametrize(
    ("value", "unit", "usual", "told"),
    [
        (180.0, "Pa", [2e7], "x = 180 Pa, usually about 2e+07 Pa; did you mean 180 bar?"),
        (20.0, "bar", [2e7], "x = 20 bar, usually about 2e+07 bar; is the unit right?"),
        (2e7, "bar", [200.0], "x = 2e+07 bar, usually about 200 bar; did you mean 2e+07 Pa?"),
        (-40.0, "rad", [0.5], "x = -40 rad, usually about 0.5 rad; did you mean -40 deg?"),
        (1e6, "furlong", [1.0], "x = 1e+06 furlong, usually about 1 furlong; is the unit right?"),
        (0.0, "Pa", [2e7], ""),
        (np.inf, "Pa", [2e7], ""),
        (180.0, "Pa", [0.0], ""),
        (999.0, "1", [1.0], ""),
        (1000.0, "1", [1.0], "x = 1000, usually about 1; is the unit right?"),
    ],
)
def test_the_unit_that_is_meant(value, unit, usual, told):
    """The common unit in which the value is the nearest to usual; none if it is near in none."""
    assert doubt("x", value, unit, usual) == told
