"""A system of FMUs as an .ssp: valid for the schema, and run by another tool's master."""

import zipfile
from importlib.resources import files

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd, read_ssv
from kit.mistakes import problem, table
from lxml import etree

from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

WIRES = [("first.level", "second.target"), ("second.mixed", "product.left")]


@pytest.fixture(scope="module")
def fmus(toy_dir):
    """Two low-pass filters and a product."""
    decay = toy_dir / "decay.fmu"
    return {"first": decay, "second": decay, "product": toy_dir / "gain.fmu"}


@pytest.fixture(scope="module")
def system(fmus, tmp_path_factory):
    """The SSP of two filters in a row and a product."""
    chain = assemble(
        fmus,
        WIRES,
        start={"first.level": 0.5, "second.gain": 4.0},
        name="chain",
        inputs={"command": ("first.target", "product.right")},
        stop=2.0,
        step=1e-3,
    )
    return write_ssp(
        chain,
        tmp_path_factory.mktemp("ssp") / "chain.ssp",
        resources={"readme.txt": b"read me"},
        sets={"slow": {"first.gain": 0.1, "second.gain": 0.2}, "fast": {"first.gain": 10.0}},
        bound=("slow",),
    )


def test_structure_is_valid_and_complete(system):
    """FMPy reads the structure against the SSP 1.0 schema; components, wires and values are there."""
    ssd = read_ssd(str(system), validate=True)
    assert (ssd.version, ssd.name) == ("1.0", "chain")
    assert [c.name for c in ssd.system.elements] == ["first", "second", "product"]
    ends = [(c.startElement, c.startConnector, c.endElement, c.endConnector) for c in ssd.system.connections]
    assert ("first", "level", "second", "target") in ends
    assert (None, "command", "product", "right") in ends
    root = structure(system)
    assert root.find("{*}DefaultExperiment").get("stopTime") == "2"
    assert [u.get("name") for u in root.iterfind("{*}Units/{*}Unit")] == ["1", "1/s"]
    second = root.find(".//{*}Component[@name='second']")
    assert [(p.get("name"), p[0].get("value")) for p in second.iter("{*}Parameter")] == [("gain", "4")]


def test_parameter_sets_are_valid_and_complete(system):
    """Every set is a file that FMPy validates against its schema; default sets are bound."""
    bindings = structure(system).iterfind("{*}System/{*}ParameterBindings/{*}ParameterBinding[@source]")
    assert [b.get("source") for b in bindings] == ["resources/slow.ssv"]
    found = {p.name: (p.value, p.unit) for p in read_ssv(str(system), "resources/slow.ssv").parameters}
    assert found == {"first.gain": ("0.1", "1"), "second.gain": ("0.2", "1")}


def structure(system):
    """The root of SystemStructure.ssd."""
    return etree.fromstring(zipfile.ZipFile(system).read("SystemStructure.ssd"))


def test_connected_inputs_fmus_and_resources(system):
    """Inputs without a source are no connectors, which masters would set; all files are under resources/."""
    ssd = read_ssd(str(system))
    connectors = {c.name: [k.name for k in c.connectors if k.kind == "input"] for c in ssd.system.elements}
    assert connectors == {"first": ["target"], "second": ["target"], "product": ["left", "right"]}
    names = zipfile.ZipFile(system).namelist()
    assert names == sorted(names)
    assert {f"resources/{n}" for n in ("first.fmu", "second.fmu", "product.fmu", "readme.txt")} <= set(names)


def test_fmpy_simulates_the_system(system):
    """FMPy's own master steps the system; the first filter follows its exponential."""
    result = simulate_ssp(str(system), stop_time=1.0, step_size=0.01, input={"command": lambda _: 2.0})
    # FMPy hands the command over one step late and its row n is after n + 1 steps: 99 steps with the command
    late = np.exp(-2 * 0.99)
    # integrator error at tolerance 1e-6; FMPy does not apply start values, so level starts at 1
    assert result["first.level"][-1] == pytest.approx(2 + (np.exp(-0.02) - 2) * late, rel=1e-5)


@table(__file__, "system", "wires, inputs, start, expected")
def test_impossible_system_is_refused_by_name(fmus, wires, inputs, start, expected):
    """A connection to a missing port, in the wrong direction or to a fed input is refused by name."""
    assert expected in problem(lambda: assemble(fmus, wires, start, "x", inputs))


@table(__file__, "sets", "options, words")
def test_impossible_sets_are_refused_by_name(fmus, tmp_path, options, words):
    """Values of an unknown variable, a binding to an unknown set, an unknown version."""
    assert words in problem(lambda: write_ssp(assemble(fmus, WIRES), tmp_path / "x.ssp", **options))


SCHEMAS = {"ssd": "Description", "ssv": "ParameterValues"}


def test_version_2_is_valid_against_its_schema(unpacked, tmp_path):
    """With FMUs of FMI 3.0 and the types of that version."""
    decay = unpacked[3, "decay"].with_suffix(".fmu")
    system = write_ssp(
        assemble({"first": decay, "second": decay}, WIRES[:1], start={"first.level": 0.5}, name="chain"),
        tmp_path / "chain.ssp",
        sets={"slow": {"first.gain": 0.1}},
        bound=("slow",),
    )
    folder = files("pyssp_standard") / "resources" / "ssp2"
    with zipfile.ZipFile(system) as archive:
        for name in archive.namelist():
            kind = name.rpartition(".")[2]
            if kind in SCHEMAS:
                schema = etree.XMLSchema(file=str(folder / f"SystemStructure{SCHEMAS[kind]}.xsd"))
                schema.assertValid(etree.fromstring(archive.read(name)))
    types = {c[0].tag.rpartition("}")[2] for c in structure(system).iter("{*}Connector")}
    assert types == {"Float64"}
