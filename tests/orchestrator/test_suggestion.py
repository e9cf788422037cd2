"""The suggested coupling of an SSP: where it is read, what overrides it, what is refused."""

import zipfile
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd
from kit.mistakes import problem, table
from lxml import etree
from pyssp_standard.ssd import SSD

from orchestrator import Coupling, Trace, load, run
from orchestrator.__main__ import main
from orchestrator.engine.result import read_metadata

PAIR = Path(__file__).with_name("pair.ssd").read_text(encoding="utf-8")  # two coupled masses
HERMITE = 'master="hermite" step="0.01" passes="3" tolerance="1e-6" guard="0"'
FACTOR = '<hc:Factor component="a" steps="4"/>'


def coupling(attributes=HERMITE, inside=""):
    return f"<hc:Coupling {attributes}>{inside}</hc:Coupling>"


def annotated(*elements):
    """Annotations: one of another tool, then one of this project."""
    kind = 'type="harvester-cosim" xmlns:hc="urn:harvester-cosim:coupling"'
    ours = f"<ssc:Annotation {kind}>{''.join(elements)}</ssc:Annotation>"
    other = '<ssc:Annotation type="org.example"><Coupling master="none"/></ssc:Annotation>'
    return f"<ssd:Annotations>{other}{ours}</ssd:Annotations>"


def ssd(experiment="", **places):
    usual = dict.fromkeys(("in_system", "in_component", "bindings", "at_end"), "")
    start = 'startElement="b" startConnector="x"'
    return PAIR.format(start=start, experiment=experiment, **usual | places)


@pytest.fixture
def make(fmus, zip_ssp):
    """An .ssp with the two coupled masses."""
    parts = {"resources/a.fmu": fmus["mass_a"], "resources/b.fmu": fmus["mass_b"]}
    return lambda *args, **places: zip_ssp(ssd(*args, **places), parts)


@pytest.mark.parametrize("place", ["experiment", "in_system", "at_end"])
def test_the_suggestion_is_taken_where_nobody_says_otherwise(make, place):
    """From any of the three places that a file has for annotations."""
    path = make(**{place: annotated(coupling(inside=f"<!-- fine -->{FACTOR}"))})
    suggested = Coupling("hermite", passes=3, tolerance=1e-6, guard=0, factors={"a": 4})
    system = load(path)
    assert (system.coupling, system.step) == (suggested, 0.01)
    result, told = run(path), run(path, master=suggested, step=0.01)
    assert result.coupling == suggested
    assert result.card.steps == 10
    np.testing.assert_array_equal(result.trace["a.x"], told.trace["a.x"])


def test_what_puts_a_suggestion_aside(make):
    """None, an empty one, one of another tool; a given master, with its step; a step alone leaves it."""
    for path in (make(), make(annotated())):
        assert (load(path).coupling, load(path).step) == (None, None)
    path = make(annotated(coupling()))
    result = run(path, master="jacobi")
    assert result.coupling == Coupling("jacobi")
    assert result.card.step == 1e-3  # of the FMUs or of nobody
    result = run(path, step=0.02)
    assert (result.coupling.master, result.card.step) == ("hermite", 0.02)


@table(__file__, "options", "expected, options")
def test_the_command_line_changes_single_settings(make, tmp_path, expected, options):
    """The choices of the file are kept unless a master is given."""
    path = make(annotated(coupling(inside=FACTOR)))
    assert main(["run", str(path), "--out", str(tmp_path / "o.csv"), *options.split()]) == 0
    metadata = read_metadata(tmp_path / "o.csv")
    assert metadata.coupling == Coupling("hermite", guard=0, **expected).settings
    assert metadata.steps == (100 if "--master" in options else 10)


def test_all_attributes_are_read(make):
    """Floating-point numbers, integers and text; those of other namespaces are passed over."""
    many = 'master="gauss-seidel" order="2" adaptive="1e-3" largest="0.01"'
    expected = Coupling("gauss-seidel", 2, adaptive=1e-3, largest=0.01)
    other = 'xmlns:x="urn:x" x:note="mine" master="hermite"'
    for text, found in ((many, expected), (other, Coupling("hermite"))):
        assert load(make(annotated(coupling(text)))).coupling == found


@table(__file__, "mistakes", "text, message")
def test_a_mistake_names_file_line_and_attribute(make, text, message):
    """In one line."""
    path = make(annotated(text))
    line = etree.fromstring(zipfile.ZipFile(path).read("SystemStructure.ssd")).find(".//{*}DefaultExperiment")
    start = f"{path}/SystemStructure.ssd: line {line.sourceline}: {message}"
    assert problem(lambda: load(path)).startswith(start)


def test_one_in_another_place_is_left_out_with_a_note(fmus, zip_ssp):
    """In a nested file or in a component: only the outermost system can suggest a coupling."""
    parts = {f"resources/{name}.fmu": fmus[f"mass_{name}"] for name in "ab"}
    inner = zip_ssp(ssd(annotated(coupling())), parts, "inner.ssp")
    part = f"""<ssd:Component name="s" type="application/x-ssp-package" source="resources/inner.ssp">
{annotated(coupling('master="hermite"'))}</ssd:Component>"""
    text = ssd(annotated(coupling('master="jacobi"'))).replace("<ssd:Elements>", f"<ssd:Elements>{part}")
    path = zip_ssp(text, parts | {"resources/inner.ssp": inner})
    system = load(path)
    assert (system.coupling, system.step) == (Coupling("jacobi"), None)
    told = "annotation of type harvester-cosim: left out, only one of the outermost system counts"
    places = "SystemStructure.ssd: line 8", "resources/inner.ssp/SystemStructure.ssd: line 20"
    expected = [f"{path}/{place}: {told}" for place in places]
    assert [note for note in system.notes if "left out" in note] == expected


def test_suggestions_that_cannot_be_followed(make):
    """Two are ambiguous; a step beyond the stop time names its place, unless another one is given."""
    path = make(annotated(coupling()), at_end=annotated(coupling()))
    told = "expected one Coupling in annotations of type harvester-cosim, got some in"
    assert told in problem(lambda: load(path))
    path = make(annotated(coupling('step="0.3"')))
    told = r"\.ssd: line \d+: Coupling: step: expected at most the time from 0 to 0\.1 s, got 0\.3 s"
    problem(lambda: run(path), told)
    assert run(path, step=0.05).card.steps == 2


def test_other_tools_pass_it_over(make, tmp_path):
    """The file is valid for the schemas of SSP 1.0 and 2.0, and two other readers accept it."""
    text = ssd(annotated(coupling(inside=FACTOR)))
    path = make(annotated(coupling(inside=FACTOR)))
    assert [c.name for c in read_ssd(str(path), validate=True).system.elements] == ["a", "b"]
    (tmp_path / "SystemStructure.ssd").write_text(text, encoding="utf-8")
    assert SSD(tmp_path / "SystemStructure.ssd").name == "pair"
    second = text.replace('version="1.0"', 'version="2.0"').replace("ssc:Real", "ssc:Float64")
    schema = files("pyssp_standard") / "resources" / "ssp2" / "SystemStructureDescription.xsd"
    etree.XMLSchema(file=str(schema)).assertValid(etree.fromstring(second))


def test_a_system_keeps_its_suggestion_when_it_is_changed(make):
    """Cuts, start values and scenarios do not change it."""
    system = load(make(annotated(coupling())))
    assert system.without("a.x2").with_start({"a.x2": 0.1}).coupling == system.coupling
    level = Trace(np.array([0.0, 0.1]), {"a.x2": np.array([0.0, 0.0])})
    assert run(system, level).coupling == system.coupling
