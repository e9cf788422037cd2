"""Modelica package of the machine: its code, and examples/modelica simulated by OpenModelica."""

import re
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kit import shards
from kit.mistakes import problem
from kit.openmodelica import openmodelica
from kit.work_cycle import PRESSURES as PORTS

from benchmarks.reference import TOLERANCE, work_cycle
from fmus.machine import CONSTANT_INPUTS, LEVERS
from fmus.machine.parts import FERIC
from fmus.monolith import join, simulate
from fmus.operator_input.work_cycle import COMMANDS
from orchestrator.__main__ import main
from orchestrator.modelica import write_package

EXAMPLES = Path(__file__).parents[2] / "examples" / "modelica"
POSE = {"initial_swing_angle": 0.3, "initial_boom_angle": 0.5, "initial_stick_angle": -1.2}
CASES: Mapping[str, Mapping[str, float]] = {"": {}, "OtherPose": POSE, "HeavyHead": {"head_mass": 600.0}}
ANGLES = [f"{joint}_angle" for joint in ("swing", "boom", "stick")]
PRESSURES = [name.partition(".")[2] for name in PORTS]


@pytest.fixture(scope="module")
def package(fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Package.mo of the machine in parts, as one block, and of one variant."""
    files = [fmu_dir / name for name in ("harvester.ssp", "harvester.fmu", "variants/swing_detailed.fmu")]
    return write_package(files, tmp_path_factory.mktemp("modelica"), "Harvester", CONSTANT_INPUTS, LEVERS)


def block(package: Path, name: str) -> str:
    """The text of one block."""
    text = package.read_text(encoding="utf-8")
    return text.partition(f"    block {name} ")[2].partition(f"    end {name};")[0]


def test_each_fmu_is_a_block_with_its_parameters_and_units(package, fmu_dir):
    """Every parameter of swing.fmu with its unit and value; the FMU itself is a resource."""
    with zipfile.ZipFile(fmu_dir / "swing.fmu") as archive:
        described = archive.read("modelDescription.xml").decode()
    pattern = r'name="(\w+)"[^>]*causality="parameter".*?unit="([^"]+)".*?start="([^"]+)"'
    declared = re.findall(pattern, described, re.S)
    shown = re.findall(r'parameter Real (\w+)\(unit = "([^"]+)"[^)]*\) = (\S+) "', block(package, "Swing"))
    values = {name: (unit, float(value)) for name, unit, value in shown}
    assert {name: (unit, float(value)) for name, unit, value in declared}.items() <= values.items()
    folder = package.parent / "Resources" / "FMUs" / "swing"
    assert (folder / "modelDescription.xml").read_text(encoding="utf-8") == described


def test_an_output_is_computed_with_the_inputs_that_it_depends_on(package):
    """Positions and speeds of the arm do not depend on forces, so that tools find no algebraic loop."""
    pattern = r"\{([\w, ]+)\} =\s+Internal\.outputs\(.*?(\{[\w, ]+\}|fill\(0\.0, 0\)), \{[\d, ]+\}\)"
    calls = re.findall(pattern, block(package, "Manipulator"), re.S)
    used = {name: inputs for names, inputs in calls for name in names.split(", ")}
    assert used["boom_position"] == used["swing_speed"] == "fill(0.0, 0)"
    assert "boom_force" in used["boom_acceleration"]


def test_rates_are_not_needed_in_model_exchange(package):
    """Neither inputs for rates nor outputs that only pass them on are in the blocks."""
    assert not re.search(r"RealInput \w+_rate", package.read_text(encoding="utf-8"))
    assert "swing_acceleration" not in block(package, "Swing")


def test_a_package_is_replaced_and_nothing_else_is_overwritten(fmu_dir, tmp_path):
    """A folder with the name of the package that the command did not write is kept."""
    first = write_package([fmu_dir / "swing.fmu"], tmp_path, "Drive").read_text(encoding="utf-8")
    assert write_package([fmu_dir / "swing.fmu"], tmp_path, "Drive").read_text(encoding="utf-8") == first
    (tmp_path / "Mine").mkdir()
    (tmp_path / "Mine" / "package.mo").write_text("package Mine end Mine;")
    told = problem(lambda: write_package([fmu_dir / "swing.fmu"], tmp_path, "Mine"))
    assert "Mine: the folder exists, but is not a package that this command wrote" in told
    assert (tmp_path / "Mine" / "package.mo").read_text() == "package Mine end Mine;"


def test_an_fmu_of_fmi_3_is_refused(fmi3_dir, tmp_path):
    """tests/tools/test_modelica_foreign.py has the others."""
    told = problem(lambda: write_package([fmi3_dir / "swing.fmu"], tmp_path))
    assert told.endswith("swing.fmu: expected an FMU for Model Exchange in FMI 2.0, got FMI 3.0")


@shards.tools
def test_the_next_step_that_the_command_prints_runs(fmu_dir, tmp_path, monkeypatch, capsys):
    """The model and the line for OpenModelica, as they are printed."""
    monkeypatch.chdir(tmp_path)
    assert main(["modelica", str(fmu_dir / "harvester.fmu"), "--name", "Mine_2"]) == 0
    pattern = r"OpenModelica:\n(.*)\nwith a file .*?\n(.*)"
    script, model = re.search(pattern, capsys.readouterr().out, re.S).groups()
    (tmp_path / "Mine.mo").write_text(model)
    (tmp_path / "a.mos").write_text(f"{script} getErrorString();")
    said = openmodelica(tmp_path / "a.mos")
    assert "The simulation finished successfully" in said, said


@pytest.fixture(scope="module")
def results(fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with what `omc run.mos` writes; the FMUs are those of the build."""
    top = tmp_path_factory.mktemp("openmodelica")
    folder = Path(shutil.copytree(EXAMPLES, top / "examples" / "modelica"))
    build = Path(shutil.copytree(fmu_dir, top / "build", ignore=shutil.ignore_patterns("fmi3")))
    files = [build / "harvester.ssp", build / "harvester.fmu", *sorted((build / "variants").glob("*.fmu"))]
    write_package(files, build / "modelica", "Harvester", CONSTANT_INPUTS, LEVERS)
    said = openmodelica(folder / "run.mos")
    (folder / "results" / "log.txt").write_text(said)
    return folder / "results"


def read(results: Path, name: str) -> pd.DataFrame:
    """One result, of the last row at each time."""
    file = results / f"HarvesterExamples.{name}_res.csv"
    assert file.is_file(), (results / "log.txt").read_text()
    return pd.read_csv(file).drop_duplicates("time", keep="last")


@pytest.fixture(scope="module")
def truth() -> Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]]:
    """Time and outputs of the monolithic solution by case."""
    time, commands = work_cycle()
    model = join(FERIC.subsystems, FERIC.connections, FERIC.inputs)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(name) for name in COMMANDS]] = commands
    found = {}
    for case, changed in CASES.items():
        p = model.p.copy()
        for name, value in changed.items():
            p[model.parameters.index(f"manipulator.{name}")] = value
        _, y = simulate(model, time, inputs, p, TOLERANCE)
        found[case] = time, dict(zip((n.split(".")[1] for n in model.output_names), y.T, strict=True))
    return found


def errors(result: pd.DataFrame, time: np.ndarray, exact: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Largest error of each signal over its range."""
    columns = {name.split(".")[-1]: name for name in result if not name.startswith("$")}
    at = np.searchsorted(time, result["time"] - 1e-9)
    on = np.abs(time[np.minimum(at, time.size - 1)] - result["time"]) < 1e-9  # not the rows of events
    assert on.sum() > 2000
    return {
        name: float(np.abs(result[columns[name]][on] - exact[name][at[on]]).max() / np.ptp(exact[name]))
        for name in (*ANGLES, *PRESSURES)
    }


@shards.tools
@pytest.mark.parametrize(
    ("name", "case"),
    [
        *((f"Imported.{case or 'OneBlock'}", case) for case in CASES),
        *((f"Parts.{case or 'Signals'}", case) for case in CASES),
        ("Parts.Flanges", ""),
    ],
)
def test_openmodelica_solves_the_machine(results, truth, name, case):
    """By its import and in parts, also with another pose or mass: 0.001 % in angles, 0.01 % in pressures.

    DASSL at 1e-8: measured 5e-8 of range in angles and 5e-6 in pressures.
    """
    found = errors(read(results, name), *truth[case])
    assert max(found[n] for n in ANGLES) < 1e-5, found
    assert max(found[n] for n in PRESSURES) < 1e-4, found


@shards.tools
def test_constant_forces_at_the_flanges_hold_the_arm(results):
    """The sign of the adapters: pushes that balance the weight leave boom and stick where they are.

    With the other sign the boom falls by half a radian.
    """
    result = read(results, "Parts.HeldByForces")
    for joint in ("boom", "stick"):
        angle = result[f"arm.block_.{joint}_angle"]
        assert np.ptp(angle) < 1e-6  # forces are given to 1e-6 N of 1e5


@shards.tools
def test_hydraulics_of_ones_own_drive_the_arm(results):
    """A cylinder in Modelica, with der() of the flange's position: rest, then the volume that oil takes.

    The volume that was pumped is that of the stroke, but for what the pressure compresses, 1.2 MPa / 1.6 GPa
    of 4 L, and for the swinging on the oil.
    """
    result = read(results, "Parts.OwnHydraulics")
    time, s = result["time"].to_numpy(), result["boom.rod.s"].to_numpy()
    assert np.ptp(s[time <= 0.2]) < 1e-9
    pumped = np.trapezoid(result["boom.inflow"], time)
    assert 0.01131 * (s[-1] - s[0]) == pytest.approx(pumped, rel=0.01)
