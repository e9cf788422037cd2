"""What ran, known later: FMUs know the file of their parameters, traces their FMUs and changed values."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from lxml import etree

from fmus.export.build import build, packages
from fmus.machine.build import harvester_machine
from fmus.machine.one_block import harvester_block
from fmus.parameters import not_shipped
from fmus.supply import SUPPLY
from orchestrator import load, read_trace, run
from orchestrator.__main__ import main
from orchestrator.base.files import Location
from orchestrator.engine.result import read_metadata
from orchestrator.fmi.interface import read_interface
from orchestrator.results import validate_system
from orchestrator.ssp.provenance import OtherValue, checksum


@pytest.fixture(scope="module")
def my_file(tmp_path_factory) -> Path:
    """A file of parameters as `identify` writes them."""
    file = tmp_path_factory.mktemp("my") / "my.toml"
    shutil.copy(Path(__file__).with_suffix(".toml"), file)
    return file


@pytest.fixture(scope="module")
def supplies(my_file) -> dict[str, Path]:
    """The supply built with the file and as shipped, both in FMI 2.0, and the former in FMI 3.0."""
    mine, folder = harvester_machine(my_file).components["supply"], my_file.parent
    return {
        "mine": build(mine, folder / "build"),
        "mine3": build(mine, folder / "build/fmi3", fmi=3),
        "shipped": build(SUPPLY, folder / "shipped"),
    }


@pytest.fixture
def here(supplies, tmp_path, monkeypatch) -> Path:
    """A working directory whose folder build has the supply that was built with the file."""
    monkeypatch.chdir(tmp_path)
    Path("build").mkdir()
    shutil.copy(supplies["mine"], "build/supply.fmu")
    shutil.copy(supplies["shipped"], "shipped.fmu")
    return tmp_path


def digest(path: Path) -> str:
    """SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_values_that_equal_the_shipped_ones_do_not_count(my_file):
    """Of lists each entry that differs counts; a value for one part changes that part only."""
    families = harvester_machine(my_file).families.values()
    found = {sub.name: sorted(not_shipped(sub)) for family in families for sub in family.values()}
    assert found["supply"] == ["pressure_setting"]
    assert found["boom_stick"] == ["valve_pa_command_1", "valve_pa_command_2"]
    assert found["swing"] == found["swing_quasistatic"] == ["valve_area", *found["boom_stick"]]
    assert found["manipulator"] == []


def test_each_fmu_knows_its_file_and_the_shipped_values(my_file, tmp_path):
    """Parts, variants, controller and the whole machine, in both versions; shipped FMUs say nothing."""
    machine = harvester_machine(my_file)
    variant, whole = machine.families["swing"]["quasistatic"], (harvester_block(machine), machine.controller)
    for sub, name in ((variant, "valve_area"), *((sub, "swing_valve_area") for sub in whole)):
        assert not_shipped(sub)[name].shipped == 4e-5
    for package in packages(variant, 1e-3, 1.0, versions=[2, 3]).values():
        (tmp_path / "modelDescription.xml").write_bytes(package["modelDescription.xml"])
        (own,) = read_interface(Location(tmp_path)).model.parameter_sets
        assert (own.file, own.sha256) == ("my.toml", digest(my_file))
        assert own.shipped == {"valve_area": "4e-05", "valve_pa_command_1": "0", "valve_pa_command_2": "0"}


def test_shipped_fmus_have_no_annotation(supplies):
    """And the annotation is where each version of FMI wants it, apart from that of the inputs."""
    assert read_interface(Location(supplies["shipped"])).model.parameter_sets == ()
    for name, path in (("mine", "VendorAnnotations/Tool"), ("mine3", "Annotations/Annotation")):
        root = etree.fromstring(Location(supplies[name]).member("modelDescription.xml").read())
        found = [e.get("name") or e.get("type") for e in root.iterfind(path)]
        assert found == ["harvester-cosim", "harvester-cosim.parameters"]
        assert [s.file for s in read_interface(Location(supplies[name])).model.parameter_sets] == ["my.toml"]


@pytest.mark.usefixtures("here")
def test_commands_say_what_the_fmus_were_built_with(capsys):
    """`run` in a note of its card, `parameters` with file and shipped value; for shipped FMUs neither."""
    note = "build/supply.fmu was built with my.toml: 1 parameter differs from the shipped ones"
    assert main(["run", "build/supply.fmu", "--stop", "0.01"]) == 0
    assert note in capsys.readouterr().out
    assert main(["parameters", "supply"]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("pressure_setting"))
    assert row.split(maxsplit=3)[1:3] == ["1.8e+07", "Pa"]
    assert row.endswith("identified; built with my.toml, shipped: 2.0684e+07")
    shutil.copy("shipped.fmu", "build/supply.fmu")
    for command in (["run", "shipped.fmu", "--stop", "0.01"], ["parameters", "supply"]):
        assert main(command) == 0
        assert "built with" not in capsys.readouterr().out


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
def test_a_trace_knows_its_fmu_and_its_values(my_file, suffix):
    """Checksums and origins are next to the trace, and inside of formats that have room for them."""
    options = ["--set", "supply.reservoir_pressure=1bar", "--stop", "0.01", "--out", f"t{suffix}"]
    assert main(["run", "build/supply.fmu", *options]) == 0
    if suffix != ".csv":
        Path("t.run.json").unlink()
    known = read_metadata(Path(f"t{suffix}")).provenance
    fmu = "build/supply.fmu"
    assert known.fmus["supply"] == {"file": fmu, "sha256": digest(Path(fmu))}
    assert known.files["my.toml"] == digest(my_file)
    assert known.values == (
        OtherValue("supply.pressure_setting", 18e6, "Pa", 20.684e6, "my.toml"),
        OtherValue("supply.reservoir_pressure", 1e5, "Pa", 0.0, "--set"),
    )
    assert "supply.supply_pressure" in read_trace(f"t{suffix}").signals


@pytest.mark.usefixtures("here")
def test_compare_lists_the_parameters_that_differ(capsys):
    """With the value and the origin in each run; a parameter with the same value in both is not listed."""
    both = ["--set", "supply.reservoir_pressure=1e5", "--stop", "0.01", "--out"]
    Path("shipped").mkdir()
    shutil.copy("shipped.fmu", "shipped/supply.fmu")
    assert main(["run", "build/supply.fmu", *both, "a.csv"]) == 0
    assert main(["run", "shipped/supply.fmu", *both, "b.csv"]) == 0
    capsys.readouterr()
    assert main(["compare", "a.csv", "b.csv", "--out", "out"]) == 0
    told = capsys.readouterr().out
    row = next(line for line in told.splitlines() if line.startswith("supply.pressure_setting"))
    assert row.split() == ["supply.pressure_setting", "bar", "180", "(my.toml)", "206.84"]
    assert "reservoir_pressure" not in told
    assert "the FMU files of supply differ" in told
    stored = json.loads(Path("out/comparison.json").read_text(encoding="utf-8"))
    assert stored["runs"]["a"]["provenance"]["values"][0]["origin"] == "my.toml"


def test_a_value_that_is_set_back_does_not_differ(supplies):
    """Origins count by what they do: --set with the shipped value leaves nothing to tell."""
    shipped = run(load(supplies["mine"]), stop=0.01, set={"supply.pressure_setting": "206.84bar"})
    assert shipped.provenance.values == ()


def test_validate_says_first_that_it_compares_other_numbers(fmu_dir, tmp_path, monkeypatch, capsys):
    """Before anything runs: which values differ from those of the reference that comes with the system."""
    monkeypatch.chdir(tmp_path)
    Path("build").mkdir()
    shutil.copy(fmu_dir / "harvester.ssp", "build")

    def no_run(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(validate_system, "run_to_file", no_run)
    assert main(["validate", "--set", "manipulator.head_mass=0.6t"]) == 130
    assert capsys.readouterr().out.splitlines()[:2] == [
        "manipulator.head_mass is 600 kg",
        "Work cycle, monolithic solution was computed with the shipped parameter values: expect differences",
    ]
    assert main(["validate"]) == 130
    assert capsys.readouterr().out == ""


def test_an_unpacked_fmu_has_the_checksum_of_its_files(tmp_path):
    """It changes with a file, and not with the order in which the system lists them."""
    for name in ("a", "b"):
        (tmp_path / name).write_text(name)
    before = checksum(Location(tmp_path))
    (tmp_path / "c").write_text("c")
    assert len(before) == 64
    assert checksum(Location(tmp_path)) not in ("", before)
