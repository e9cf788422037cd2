"""The experiments shipped with the project's FMUs: solved on the equations, reproduced by each FMU."""

import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import fmpy
import numpy as np
import pandas as pd
import pytest
from kit import shards
from lxml import etree

from benchmarks import reference
from check.test_probes import opened
from fmus.contract import quantities
from fmus.controller import CONTROLLER
from fmus.export import model_description
from fmus.export.build import build
from fmus.export.model_description import FOLDER, NRMSE_LIMIT, TOLERANCE, data_file, ls_ref_files
from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import FAMILIES, FERIC
from fmus.operator_input import OPERATOR
from fmus.parameters import values
from fmus.swing import SWING
from fmus.valve_actuation import ACTUATION
from orchestrator.check.ls_ref import EXPERIMENT, ExperimentComparison, cases, compare_experiment, table
from orchestrator.check.ls_ref import parameter_set as read_parameters
from orchestrator.check.probe_process import probe_limits, use_probe_limits

OTHERS = [s for variants in FAMILIES.values() for s in variants.values() if s.name not in FERIC.components]
# but the ideal source: it has no states, there is nothing to prove
SUBSYSTEMS = {
    s.name: s
    for s in (*FERIC.components.values(), *OTHERS, ACTUATION, CONTROLLER, HARVESTER)
    if quantities(s.states)
}


def built(folder: Path, name: str) -> Path:
    """The FMU of a subsystem in a folder of the built machine."""
    return folder / ("variants" if SUBSYSTEMS[name] in OTHERS else "") / f"{name}.fmu"


def compared(path: Path, folder: Path) -> ExperimentComparison:
    """The first experiment of an FMU."""
    subject = opened(path, folder)
    found, texts = cases(folder)
    assert texts == []
    return compare_experiment(subject, found[0])


@pytest.fixture(autouse=True)
def _short() -> Iterator[None]:
    """A check runs the default experiment before the shipped one; here it is cut short."""
    with use_probe_limits(replace(probe_limits(), work_time=0.01)):
        yield


# FMI 3 of one block, of a part with and of one without inputs, and of the controller: what differs between
# the versions is the same C code for every part
IN_FMI_3 = {(HARVESTER.name, 3), (SWING.name, 3), (OPERATOR.name, 3), (CONTROLLER.name, 3)}


@pytest.mark.parametrize(
    ("name", "major"),
    shards.few({(name, 2) for name in SUBSYSTEMS} | IN_FMI_3, product(SUBSYSTEMS, (2, 3)), shards.machine),
)
def test_each_fmu_reproduces_the_experiment_it_ships(request, tmp_path, name, major):
    """CS with the FMU's own solver against CVODES on the equations: 1e-5 of range on every signal."""
    folder = request.getfixturevalue({2: "fmu_dir", 3: "fmi3_dir"}[major])
    result = compared(built(folder, name), tmp_path)
    assert result.problems == []
    assert result.failure == ""
    # ten thousand times the tolerance of the experiment: errors over 8 s and in second derivatives
    assert max(result.errors.values()) < NRMSE_LIMIT, result.errors


DAMAGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "0.01 % off": lambda column: 1.0001 * column,
    "a spike": lambda column: np.where(np.arange(column.size) == 100, column + 0.01 * np.ptp(column), column),
    "one row late": lambda column: np.roll(column, 1),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_result_is_an_error(fmu_dir, tmp_path, damage):
    """One pressure of the shipped result: the exit status of `check` follows from a finding of this kind."""
    subject = opened(built(fmu_dir, SWING.name), tmp_path)
    file = tmp_path / FOLDER / "result.csv"
    rows = pd.read_csv(file)
    rows["swing_pressure_a"] = DAMAGES[damage](rows["swing_pressure_a"].to_numpy())
    rows.to_csv(file, index=False)
    (finding,) = EXPERIMENT(subject)
    assert finding.severity == "error"
    assert "differs from result.csv: NRMSE swing_pressure_a" in finding.text


# what this importer does is the same for each FMU
@pytest.mark.parametrize("name", shards.few([HARVESTER.name, OPERATOR.name], SUBSYSTEMS, shards.machine))
def test_another_importer_reproduces_the_result(fmu_dir, name):
    """FMPy reproduces the result when it sets the inputs of the file at each communication point."""
    path = built(fmu_dir, name)
    with zipfile.ZipFile(path) as archive, archive.open(f"{FOLDER}/result.csv") as file:
        result = np.genfromtxt(file, delimiter=",", names=True)
        members = archive.namelist()
    inputs = data_file(SUBSYSTEMS[name], "input.csv")
    assert inputs.is_file() == (f"{FOLDER}/input.csv" in members)
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type="CoSimulation",
        stop_time=float(result["time"][-1]),
        step_size=0.01,
        output_interval=0.01,
        relative_tolerance=TOLERANCE,
        start_values=read_parameters(data_file(SUBSYSTEMS[name], "parameters.ssv")),
        input=np.genfromtxt(inputs, delimiter=",", names=True) if inputs.is_file() else None,
        output=list(result.dtype.names[1:]),
    )
    rows = found[np.searchsorted(found["time"], result["time"] - 1e-6)]
    for signal in result.dtype.names[1:]:
        deviation = np.sqrt(np.mean((rows[signal] - result[signal]) ** 2)) / np.ptp(result[signal])
        assert deviation < NRMSE_LIMIT, f"{signal}: {deviation:.2g} of range"


@shards.machine
def test_the_committed_experiments_are_those_of_the_equations():
    """`python -m benchmarks.reference` writes the same inputs, parameters and beginning of each result."""
    empty, loaded = reference.machine_signals(), reference.machine_signals([reference.STEM])
    for sub in SUBSYSTEMS.values():
        moving = reference.stimuli(sub, loaded if "payload_mass" in quantities(sub.inputs) else empty)
        v = reference.start_values(sub, moving)
        _, told = table(data_file(sub, "result.csv"))
        if moving:
            _, given = table(data_file(sub, "input.csv"))
            assert set(given) == set(moving)
            for name, samples in moving.items():
                # the machine is solved to 1e-11; another CasADi rounds in another way
                column = np.array([float(x) for x in given[name]])
                assert np.allclose(samples, column, rtol=1e-7, atol=1e-7 * np.ptp(samples)), name
        stated = read_parameters(data_file(sub, "parameters.ssv"))
        assert {n: float(x) for n, x in stated.items() if n in v.p} == dict(v.p)
        found = reference.solve(sub, v, moving, 200)
        for name, column in told.items():
            shown = found[name][::4]
            expected = np.array([float(x) for x in column[: shown.size]])
            scale = quantities(sub.outputs)[name].nominal
            digits = 10.0**-reference.RESULT_DIGITS  # of the file, and as above
            assert np.allclose(shown, expected, rtol=digits, atol=1e-6 * scale), name


def test_what_is_compared_moves_and_does_not_jump():
    """No signal of the experiment depends directly on an input that jumps at the communication points."""
    n = 11
    moving = {"swing_acceleration": np.linspace(0, 1, n), "swing_speed": np.linspace(0, 1, n)}
    found = {name: np.linspace(0, 10 * q.nominal, n) for name, q in quantities(SWING.outputs).items()}
    shown = reference.compared_outputs(SWING, moving, found)
    assert "swing_torque" in shown  # of the speed, which moves by the acceleration
    assert "swing_torque_rate" not in shown  # of the acceleration
    assert "swing_void_volume" not in shown


def test_an_fmu_with_other_values_reproduces_the_same_experiment(tmp_path):
    """The parameter set contains the values of the experiment, whatever values the FMU was built with."""
    v = values(SWING)
    other = replace(v, p={**v.p, "initial_preload": 3e6, "gear_ratio": 1.1 * v.p["gear_ratio"]})
    result = compared(build(SWING, tmp_path, values=other), tmp_path / "swing")
    assert max(result.errors.values()) < NRMSE_LIMIT


def test_what_has_no_experiment_ships_none(tmp_path):
    """A source without states, a user's subsystem without a reference, and a variant with other variables."""
    assert ls_ref_files(FERIC.components["supply"]) == {}
    assert ls_ref_files(replace(SWING, values=tmp_path / "parameters.toml")) == {}
    assert ls_ref_files(replace(SWING, outputs=SWING.states)) == {}


def test_an_experiment_without_inputs_has_no_stimuli():
    """The levers have no inputs: no file, and none in the experiment."""
    files = ls_ref_files(OPERATOR)
    assert f"{FOLDER}/input.csv" not in files
    assert b"Stimuli" not in files[f"{FOLDER}/experiment.exp"]
    assert b"There are no inputs" in files[model_description.PAGE]


def test_the_files_are_small_and_the_parameter_sets_keep_the_schema():
    """Below 200 kB each; valid against the SSP 1.0 schema for parameter sets that FMPy ships."""
    file = Path(fmpy.__file__).parent / "ssp" / "schema" / "SystemStructureParameterValues.xsd"
    schema = etree.XMLSchema(etree.parse(str(file)))
    for sub in SUBSYSTEMS.values():
        files = ls_ref_files(sub)
        schema.assertValid(etree.fromstring(files[f"{FOLDER}/parameters.ssv"]))
        assert all(len(content) < 200_000 for content in files.values()), sub.name


def test_a_parameter_set_reads_back(tmp_path):
    """Every digit that a double has."""
    path = tmp_path / "p.ssv"
    given = {"a": 0.1 + 0.2, "b": 1e-300}
    path.write_bytes(model_description.reference_parameters(SWING, given))
    assert {n: float(x) for n, x in read_parameters(path).items()} == given
