"""What tools that are not here ask for: of the SSP, and of the scripts of examples, which get stand-ins."""

import re
import runpy
import sys
import zipfile
from pathlib import Path
from types import ModuleType
from unittest.mock import MagicMock

import numpy as np
import pytest
from kit.work_cycle import REFERENCE, SIGNALS
from lxml import etree

from fmus.machine.parts import FERIC

EXAMPLES = Path(__file__).parents[2] / "examples"
WIRES = sorted(FERIC.connections + FERIC.operator_wires)
STOP = 2.0  # s
WINDOW = REFERENCE["time"] <= STOP
# each signal is off by a hundredth of its range
FOUND = {name: REFERENCE[name][WINDOW] + 0.01 * np.ptp(REFERENCE[name][WINDOW]) for name in SIGNALS}
METHODS = (  # of a model in OMSimulator 3
    *("setResultFile", "removeSignalsFromResults", "addSignalsToResults", "setFixedStepSize", "setStopTime"),
    *("setLoggingInterval", "initialize", "simulate", "terminate", "delete"),
)
PRINTED = "error over range after 2 s: speed 1 %, angle 1 %, pressure 1 %\n"


def test_simulink_wires_are_those_of_the_machine():
    """build_model.m connects what harvester.ssp connects."""
    text = (EXAMPLES / "simulink" / "build_model.m").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^ +'([\w]+\.\w+)', +'(\w+\.\w+)'$", text, re.MULTILINE)) == WIRES


def test_ssp_has_what_omsimulator_and_libcosim_ask_for(fmu_dir):
    """OMSimulator 3.0 opens no system without its annotation, with a SystemGeometry or with a dictionary;
    libcosim takes the step from its annotation; Ecos and libcosim refuse connectors of the system."""
    root = etree.fromstring(zipfile.ZipFile(fmu_dir / "harvester.ssp").read("SystemStructure.ssd"))
    system = root.find("{*}System")
    assert system.find("{*}Annotations//{*}FixedStepMaster").get("stepSize") == "0.001"
    experiment = root.find("{*}DefaultExperiment/{*}Annotations//{*}FixedStepAlgorithm")
    assert experiment.get("baseStepSize") == "0.001"
    for tag in ("SystemGeometry", "SignalDictionaries", "Connectors"):
        assert system.find(f"{{*}}{tag}") is None


def script(monkeypatch: pytest.MonkeyPatch, folder: str, *arguments: object, **modules: object) -> None:
    """Run an example with stand-ins for modules; None for one that is missing."""
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name.replace("_", "."), module)
    file = EXAMPLES / folder / "run.py"
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "argv", [str(file), *map(str, arguments)])
    runpy.run_path(str(file), run_name="__main__")


@pytest.mark.parametrize(("more", "rates"), [([], True), (["--no-rates"], False)])
def test_pyfmi_has_the_parts_and_wires_of_the_ssp(fmu_dir, monkeypatch, capsys, more, rates):
    """PyFMI's master gets each FMU, each connection and the step; its result meets the reference."""
    signals, seen = {}, {}
    for name, values in FOUND.items():
        part, _, port = name.partition(".")
        signals.setdefault(part, {"time": REFERENCE["time"][WINDOW]})[port] = values

    def load_fmu(path: str, kind: str, log_file_name: str) -> str:
        assert Path(log_file_name).parent == Path(path).parent, "not in the temporary folder"
        assert (kind, Path(path).is_file()) == ("CS", True)
        return Path(path).stem

    def master(models: list[str], wires: list[tuple[str, ...]]) -> MagicMock:
        seen.update(models=models, wires=[(f"{a}.{x}", f"{b}.{y}") for a, x, b, y in wires])
        made = MagicMock()
        made.simulate_options.return_value = {}
        made.simulate.side_effect = simulate
        return made

    def simulate(final_time: float, options: dict[str, object]) -> object:
        seen.update(stop=final_time, **options)
        return signals

    pyfmi, module = ModuleType("pyfmi"), ModuleType("pyfmi.master")
    pyfmi.load_fmu, module.Master = load_fmu, master
    more = [fmu_dir / "harvester.ssp", "--stop", STOP, "--step", 5e-3, *more]
    script(monkeypatch, "pyfmi", *more, pyfmi=pyfmi, pyfmi_master=module)
    assert capsys.readouterr().out == PRINTED
    open_ports = () if rates else ("_rate", "_acceleration")
    wires = [wire for wire in (*WIRES, *FERIC.supply_wires) if not wire[1].endswith(open_ports)]
    assert sorted(seen["wires"]) == sorted(wires)
    assert set(seen["models"]) == {end.split(".")[0] for wire in seen["wires"] for end in wire}
    assert (seen["stop"], seen["step_size"], seen["block_initialization"]) == (STOP, 5e-3, True)


def test_omsimulator_records_the_signals_of_the_ssp(fmu_dir, monkeypatch, capsys):
    """OMSimulator gets the SSP, the step and the names; of rows at one time the last one is compared."""
    model = MagicMock(spec=METHODS)
    names = [f"harvester.{name}" for name in (*SIGNALS, "swing.swing_pressure_a_rate")]

    def simulate() -> None:
        recorded = [n for n in names if re.fullmatch(model.addSignalsToResults.call_args.args[0], n)]
        rows = [REFERENCE["time"][WINDOW], *(FOUND[name.partition(".")[2]] for name in recorded)]
        before = [rows[0], *(0 * values for values in rows[1:])]
        table = np.stack([before, rows], axis=2).reshape(len(rows), -1).T
        head = ",".join(f'"{name}"' for name in ("time", *recorded))
        np.savetxt(model.setResultFile.call_args.args[0], table, delimiter=",", header=head, comments="")

    model.simulate.side_effect = simulate
    tool = ModuleType("OMSimulator")
    tool.SSP = MagicMock()
    tool.SSP.return_value.instantiate.return_value = model
    ssp = fmu_dir / "harvester.ssp"
    script(monkeypatch, "omsimulator", ssp, "--stop", STOP, "--step", 5e-3, OMSimulator=tool)
    assert capsys.readouterr().out == PRINTED
    tool.SSP.assert_called_once_with(str(ssp))
    model.setFixedStepSize.assert_called_once_with(5e-3)
    model.setStopTime.assert_called_once_with(STOP)
    calls = [call[0] for call in model.method_calls]
    assert calls[-4:] == ["initialize", "simulate", "terminate", "delete"]


@pytest.mark.parametrize("folder", ["pyfmi", "omsimulator"])
def test_a_script_says_in_one_line_what_is_missing(monkeypatch, tmp_path, folder):
    """The tool, and what installs it; or the machine."""
    module = {"pyfmi": "pyfmi", "omsimulator": "OMSimulator"}[folder]
    with pytest.raises(SystemExit, match=r"^\w+ is not here .*install [^\n]+$"):
        script(monkeypatch, folder, tmp_path / "none.ssp", **{module: None})
    stand_ins = {module: MagicMock()} | ({"pyfmi_master": MagicMock()} if folder == "pyfmi" else {})
    with pytest.raises(SystemExit, match=r"none\.ssp is not there: run `harvester build` first$"):
        script(monkeypatch, folder, tmp_path / "none.ssp", **stand_ins)
