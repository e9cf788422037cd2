"""Experiments shipped with any FMU are run and compared; invalid files are reported."""

from collections.abc import Mapping
from pathlib import Path

import fmpy
import pytest
from kit.mistakes import table

from check.oscillator import Oscillators
from check.test_probes import opened
from orchestrator.check.finding import Finding
from orchestrator.check.ls_ref import EXPERIMENT, FOLDER
from orchestrator.check.subject import parse_unpacked

LS = "http://fmi-standard.org/fmi-ls-manifest"
HEAD = f'<fmiReferences xmlns:l="{LS}" l:fmi-ls-name="org.fmi-standard.fmi-ls-ref">'


@pytest.fixture(scope="module")
def result(oscillators: Oscillators) -> str:
    """Position of the oscillator over its default experiment, as a CSV file."""
    options = {"validate": False, "fmi_type": "CoSimulation", "output": ["position"]}
    rows = fmpy.simulate_fmu(str(oscillators.make()), **options)
    return "time,position\n" + "".join(f"{t!r},{x!r}\n" for t, x in rows.tolist())


def related(*rows: tuple[str, str, str]) -> str:
    """A manifest of (type, source, role)."""
    lines = "".join(f'<Related type="{t}" source="{s}" role="{r}"/>' for t, s, r in rows)
    return f"{HEAD}{lines}</fmiReferences>"


def findings(
    oscillators: Oscillators, folder: Path, files: Mapping[str, str], major: int = 2, fault: str = "none"
) -> list[Finding]:
    """Findings on the oscillator with these files; the key of the manifest is "manifest"."""
    names = {"manifest": "fmi-ls-manifest.xml"}
    extra = {f"{FOLDER}/{names.get(n, n)}": text for n, text in files.items()}
    return list(EXPERIMENT(opened(oscillators.make(major, fault, extra=extra), folder)))


EXP, CSV, SSV = "application/x-ma-hs-experiments", "text/csv", "application/x-ssp-parameter-set"
RESULT_ONLY = related((CSV, "lag_out.csv", "result"))
WITH_EXPERIMENT = related((EXP, "a.exp", "experiment"), (CSV, "r.csv", "result"))
PARAMETERS = (
    '<s:ParameterSet xmlns:s="x" version="1.0"><s:Parameters>'
    '<s:Parameter name="stiffness"><s:Real value="80"/></s:Parameter></s:Parameters></s:ParameterSet>'
)
OLD = (
    '<Experiments name="a"><Experiment name="b" startTime="0" stopTime="2" stepSize="0.01">{}'
    "</Experiment></Experiments>"
)
NEW = (
    '<Experiments name="a"><Experiment name="b"><TransientSimulation stopTime="2" stepSize="0.01"/>{}'
    "</Experiment></Experiments>"
)
REFERENCES = '<References source="r.csv"/>'


@pytest.mark.parametrize("major", [2, 3])
def test_a_result_alone_is_that_of_the_default_experiment(oscillators, tmp_path, result, major):
    """As the Reference-FMUs ship it: a CSV file with the role result."""
    (finding,) = findings(oscillators, tmp_path, {"manifest": RESULT_ONLY, "lag_out.csv": result}, major)
    assert finding.severity == "note"
    # the same calls give the same bits
    assert 'experiment "lag_out" agrees with lag_out.csv: NRMSE position 0' in finding.text


@pytest.mark.parametrize("form", [OLD, NEW], ids=["times at Experiment", "TransientSimulation"])
def test_both_forms_of_experiments_are_run(oscillators, tmp_path, result, form):
    """With the times at the element itself, and in a child."""
    files = {"manifest": WITH_EXPERIMENT, "a.exp": form.format(REFERENCES), "r.csv": result}
    (finding,) = findings(oscillators, tmp_path, files)
    assert finding.text.startswith('experiment "b" agrees with r.csv')


def test_parameters_and_inputs_of_an_experiment_are_set(oscillators, tmp_path):
    """A stiffer spring under a constant force rests at u / stiffness in the long run."""
    inner = '<Parameters source="p.ssv"/><Stimuli source="i.csv"/><References source="r.csv"/>'
    files = {
        "manifest": related((EXP, "a.exp", "experiment/validation")),
        "a.exp": NEW.format(inner).replace('stopTime="2"', 'stopTime="40"'),
        "p.ssv": PARAMETERS,
        "i.csv": "time,u\n0,160\n",
        "r.csv": "time,position\n40,2\n",
    }
    (finding,) = findings(oscillators, tmp_path, files)
    # what is left of the oscillation: exp(-0.25 * 40) = 5e-5
    assert "agrees with r.csv" in finding.text


@table(__file__, "invalid", "files, text")
def test_invalid_files_are_reported(oscillators, tmp_path, files, text):
    """A finding in one line with the file and the fault; the check continues."""
    if isinstance(files["manifest"], list):
        files = {**files, "manifest": related(*files["manifest"])}
    found = findings(oscillators, tmp_path, files)
    assert any(text in f.text for f in found), found
    assert all(f.severity in ("warning", "note") for f in found)
    assert not any(str(tmp_path) in f.text for f in found)


def test_unknown_parameters_of_a_set_are_reported(oscillators, tmp_path, result):
    """Names in the set that are not variables of the model, or cannot be set."""
    files = {
        "manifest": related((CSV, "r_out.csv", "result"), (SSV, "p.ssv", "parameter")),
        "r_out.csv": result,
        "p.ssv": PARAMETERS.replace("stiffness", "mass"),
    }
    texts = [f.text for f in findings(oscillators, tmp_path, files)]
    assert 'experiment "r_out": p.ssv sets mass, which is not a variable of the model' in texts


def test_an_experiment_that_fails_is_an_error(oscillators, tmp_path, result):
    """The message contains the call and the time, and the check continues."""
    files = {"manifest": RESULT_ONLY, "lag_out.csv": result}
    (finding,) = findings(oscillators, tmp_path, files, fault="error")
    assert finding.severity == "error"
    reason = "fmi2DoStep failed at t = 0.31 s with status error; it says: no more"
    assert f"was not completed: {reason}" in finding.text


def test_inputs_belong_to_a_result_by_their_name(oscillators, tmp_path, result):
    """model_in.csv next to model_out.csv: with a force the oscillator differs from the result."""
    files = {"manifest": RESULT_ONLY, "lag_out.csv": result, "lag_in.csv": "time,u\n0,20\n2,20\n"}
    (finding,) = findings(oscillators, tmp_path, files)
    assert finding.severity == "error"


def test_an_fmu_without_manifest_has_no_experiment(oscillators, tmp_path):
    """There are no findings."""
    assert findings(oscillators, tmp_path, {}) == []


def test_model_exchange_alone_is_told(oscillators, tmp_path, result):
    """An experiment needs an FMU for co-simulation."""
    extra = {f"{FOLDER}/fmi-ls-manifest.xml": RESULT_ONLY, f"{FOLDER}/lag_out.csv": result}
    path = oscillators.make(extra=extra)
    opened(path, tmp_path)
    file = tmp_path / "modelDescription.xml"
    head, _, tail = file.read_text(encoding="utf-8").partition("<CoSimulation")
    file.write_text(head + tail.partition("/>")[2], encoding="utf-8")
    (finding,) = EXPERIMENT(parse_unpacked(path, tmp_path))
    assert finding.severity == "note"
    assert finding.text.endswith("was not run: it has only Model Exchange")
