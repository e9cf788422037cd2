"""The experiments shipped with the project's FMUs: solved on the equations, reproduced by each FMU."""

import zipfile
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
from fmus.contract import Subsystem, quantities
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
from orchestrator.base.files import Location
from orchestrator.base.xml import read_xml
from orchestrator.ssp.parameter_sets import read_parameter_set

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


def read_parameters(path: Path) -> dict[str, str]:
    """Name -> value of a parameter set."""
    return {v.name: v.text for v in read_parameter_set(read_xml(Location(path), "ParameterSet"), {})}


# FMI 3 of one block, of a part with and of one without inputs, and of the controller: what differs between
# the versions is the same C code for every part
IN_FMI_3 = {(HARVESTER.name, 3), (SWING.name, 3), (OPERATOR.name, 3), (CONTROLLER.name, 3)}


@pytest.mark.parametrize(
    ("name", "major"),
    shards.few({(name, 2) for name in SUBSYSTEMS} | IN_FMI_3, product(SUBSYSTEMS, (2, 3)), shards.machine),
)
def test_another_importer_reproduces_the_result(request, name, major):
    """FMPy, with the inputs of the file at each communication point, against CVODES on the equations."""
    folder = request.getfixturevalue({2: "fmu_dir", 3: "fmi3_dir"}[major])
    reproduced(built(folder, name), SUBSYSTEMS[name])


def reproduced(path: Path, sub: Subsystem) -> None:
    """An FMU gives the result that it contains: 1e-5 of the range of every signal."""
    with zipfile.ZipFile(path) as archive, archive.open(f"{FOLDER}/result.csv") as file:
        result = np.genfromtxt(file, delimiter=",", names=True)
        members = archive.namelist()
    inputs = data_file(sub, "input.csv")
    assert inputs.is_file() == (f"{FOLDER}/input.csv" in members)
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type="CoSimulation",
        stop_time=float(result["time"][-1]),
        step_size=0.01,
        output_interval=0.01,
        relative_tolerance=TOLERANCE,
        start_values=read_parameters(data_file(sub, "parameters.ssv")),
        input=np.genfromtxt(inputs, delimiter=",", names=True) if inputs.is_file() else None,
        output=list(result.dtype.names[1:]),
    )
    rows = found[np.searchsorted(found["time"], result["time"] - 1e-6)]
    for signal in result.dtype.names[1:]:
        deviation = np.sqrt(np.mean((rows[signal] - result[signal]) ** 2)) / np.ptp(result[signal])
        # ten thousand times the tolerance of the experiment: errors over 8 s and in second derivatives
        assert deviation < NRMSE_LIMIT, f"{signal}: {deviation:.2g} of range"


@shards.machine
def test_the_committed_experiments_are_those_of_the_equations():
    """`python -m benchmarks.reference` writes the same inputs, parameters and beginning of each result."""
    empty, loaded = reference.machine_signals(), reference.machine_signals([reference.STEM])
    for sub in SUBSYSTEMS.values():
        moving = reference.stimuli(sub, loaded if "payload_mass" in quantities(sub.inputs) else empty)
        v = reference.start_values(sub, moving)
        told = pd.read_csv(data_file(sub, "result.csv"), index_col=0)
        if moving:
            given = pd.read_csv(data_file(sub, "input.csv"), index_col=0)
            assert set(given) == set(moving)
            for name, samples in moving.items():
                # the machine is solved to 1e-11; another CasADi rounds in another way
                assert np.allclose(samples, given[name], rtol=1e-7, atol=1e-7 * np.ptp(samples)), name
        stated = read_parameters(data_file(sub, "parameters.ssv"))
        assert {n: float(x) for n, x in stated.items() if n in v.p} == dict(v.p)
        found = reference.solve(sub, v, moving, 200)
        for name, column in told.items():
            shown = found[name][::4]
            expected = column[: shown.size]
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
    reproduced(build(SWING, tmp_path, values=other), SWING)


def test_what_has_no_experiment_or_no_stimuli_ships_none(tmp_path):
    """A source without states, no reference, other variables; the levers have no inputs, so no such file."""
    assert ls_ref_files(FERIC.components["supply"]) == {}
    assert ls_ref_files(replace(SWING, values=tmp_path / "parameters.toml")) == {}
    assert ls_ref_files(replace(SWING, outputs=SWING.states)) == {}
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
