"""SSPs of other tools: their annotations about step and master, their slips, their units, and broken ones."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from orchestrator import Coupling, Problem, load, run
from orchestrator.__main__ import main

SSP = "http://ssp-standard.org/SSP1/SystemStructure"
OMS = 'xmlns:oms="https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"'
OSP = 'xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations"'
JACOBI = Coupling("jacobi")


def annotation(kind: str, inside: str) -> str:
    """One annotation of a tool."""
    return f'<ssd:Annotations><ssc:Annotation type="{kind}">{inside}</ssc:Annotation></ssd:Annotations>'


def oms(inside: str) -> str:
    """As OMSimulator 3 writes it."""
    information = f"<oms:SimulationInformation>{inside}</oms:SimulationInformation>"
    return annotation("org.openmodelica", f"<oms:Annotations {OMS}>{information}</oms:Annotations>")


def osp(inside: str, declared: str = OSP) -> str:
    """As libcosim reads it."""
    return annotation("com.opensimulationplatform", f"<osp:Algorithm {declared}>{inside}</osp:Algorithm>")


FIXED = '<oms:FixedStepMaster description="oms-ma" stepSize="0.02" relativeTolerance="0.000100"/>'
BASE = '<osp:FixedStepAlgorithm baseStepSize="2e-2"/>'
TASK = 'xmlns:mc="com.avl.model.connect.ssp.task"'
VARIABLE = (
    '<oms:VariableStepMaster description="oms-mav" initialStepSize="0.001" minimumStepSize="0.0001" '
    'maximumStepSize="0.05" relativeTolerance="0.001"/>'
)


def ssd(
    experiment: str = "", in_system: str = "", in_component: str = "", start: str = "", bindings: str = ""
) -> str:
    """Two coupled masses with annotations in some places."""
    return f"""<ssd:SystemStructureDescription version="1.0" name="pair"
 xmlns:ssd="{SSP}Description" xmlns:ssc="{SSP}Common" xmlns:ssv="{SSP}ParameterValues">
<ssd:System name="pair"><ssd:Connectors><ssd:Connector name="push" kind="input"><ssc:Real/></ssd:Connector>
</ssd:Connectors>{bindings}<ssd:Elements>
<ssd:Component name="a" type="application/x-fmu-sharedlibrary" source="resources/a.fmu"><ssd:Connectors>
<ssd:Connector name="x2" kind="input"><ssc:Real/></ssd:Connector>
<ssd:Connector name="force" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors>{in_component}</ssd:Component>
<ssd:Component name="b" type="application/x-fmu-sharedlibrary" source="resources/b.fmu"><ssd:Connectors>
<ssd:Connector name="force" kind="input"><ssc:Real/></ssd:Connector>
<ssd:Connector name="x" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors></ssd:Component>
</ssd:Elements><ssd:Connections>
<ssd:Connection startElement="a" startConnector="force" endElement="b" endConnector="force"/>
<ssd:Connection {start}startConnector="push" endElement="a" endConnector="x2"/>
</ssd:Connections>{in_system}</ssd:System>
<ssd:DefaultExperiment startTime="0" stopTime="0.1">{experiment}</ssd:DefaultExperiment>
</ssd:SystemStructureDescription>"""


@pytest.fixture
def make(fmus, zip_ssp):
    """An .ssp with two masses."""
    parts = {"resources/a.fmu": fmus["mass_a"], "resources/b.fmu": fmus["mass_b"]}
    return lambda **places: zip_ssp(ssd(**places), parts)


# ---- step and master


FOLLOWED = {
    "OMSimulator": ({"in_system": oms(FIXED)}, JACOBI, 0.02),
    "OMSimulator 2020, unprefixed": (
        {
            "in_system": annotation(
                "org.openmodelica",
                f"<oms:SimulationInformation {OMS}>{FIXED.replace('oms:', '')}</oms:SimulationInformation>",
            )
        },
        JACOBI,
        0.02,
    ),
    "OMSimulator, steps of its choice": (
        {"in_system": oms(VARIABLE)},
        Coupling("jacobi", adaptive=1e-3, smallest=1e-4, largest=0.05),
        0.001,
    ),
    "libcosim": ({"experiment": osp(BASE)}, JACOBI, 0.02),
    "libcosim, prefix not declared": ({"experiment": osp(BASE, declared="")}, JACOBI, 0.02),
    "libcosim, before 2021": (
        {
            "in_system": annotation(
                "org.open-simulation-platform",
                f'<osp:SimulationInformation {OSP}><osp:FixedStepMaster stepSize="0.02"/></osp:SimulationInformation>',
            )
        },
        JACOBI,
        0.02,
    ),
    "Vico": (
        {
            "experiment": annotation(
                "com.github.ntnu-ihb.vico",
                '<v:MasterAlgorithm xmlns:v="vico"><v:FixedStepMaster baseStepSize="2e-2"/></v:MasterAlgorithm>',
            )
        },
        JACOBI,
        0.02,
    ),
    "OpenMCx": (
        {
            "experiment": annotation(
                "com.avl.model.connect.ssp.task", f'<mc:Task {TASK} stepType="sequential" deltaTime="0.02"/>'
            )
        },
        Coupling("gauss-seidel"),
        0.02,
    ),
    "draft of 2018": (
        {
            "in_system": '<ssd:SimulationInformation><ssd:FixedStepMaster stepSize="2e-2"/></ssd:SimulationInformation>'
        },
        JACOBI,
        0.02,
    ),
    "two that agree": ({"in_system": oms(FIXED), "experiment": osp(BASE)}, JACOBI, 0.02),
}


@pytest.mark.parametrize("name", FOLLOWED)
def test_the_step_and_the_master_of_another_tool_are_followed(make, name):
    """As its annotation says, and the card says so; without, the step would be the FMUs' own."""
    places, coupling, step = FOLLOWED[name]
    system = load(make(**places))
    assert (system.coupling, system.step, system.refusal) == (coupling, step, "")
    result = run(system)
    assert result.coupling == coupling
    if coupling.adaptive is None:
        assert result.card.steps == 5  # of 0.02 s in 0.1 s
    tool = name.split(",")[0].split()[0]
    wanted = {"draft": "OMSimulator", "two": "OMSimulator, libcosim"}.get(tool, tool)
    assert any(note.startswith(f"coupled as the annotation of {wanted} in ") for note in result.card.notes)


SOLVER = '<oms:VariableStepSolver description="cvode" relativeTolerance="0.000100"/>'
SIZES = (
    '<osp:FixedStepAlgorithm baseStepSize="2e-2"><osp:StepSizes><osp:StepSize component="a" multipleOf="2"/>'
    "</osp:StepSizes></osp:FixedStepAlgorithm>"
)
HINT = annotation("com.opensimulationplatform", f'<osp:StepSizeHint {OSP} value="0.01"/>')
REFUSED = {
    "Model Exchange": ({"in_system": oms(SOLVER)}, r"OMSimulator solves this by Model Exchange \(cvode\)"),
    "a solver of 2026": (
        {
            "in_system": annotation(
                "org.openmodelica",
                f'<oms:SimulationInformation {OMS} name="s" method="euler" tolerance="1e-6"/>',
            )
        },
        r"OMSimulator solves this by Model Exchange \(euler\)",
    ),
    "another algorithm": (
        {"experiment": osp('<osp:EccoAlgorithm baseStepSize="1"/>')},
        r"EccoAlgorithm of libcosim is not supported",
    ),
    "two that do not agree": (
        {"in_system": oms(FIXED), "experiment": osp(BASE.replace("2e-2", "1e-2"))},
        r"line \d+ \(OMSimulator\) wants jacobi, step 0\.02 s, but line \d+ \(libcosim\) wants jacobi, step 0\.01 s",
    ),
    "a step for one component": (
        {"experiment": osp(SIZES)},
        r"a wants a step of its own, 2 times the base step",
    ),
    "a hint for one component": (
        {"experiment": osp(BASE), "in_component": HINT},
        r"wants any master, step 0\.01 s, but",
    ),
    "arguments of a command": (
        {"in_system": annotation("se.umu.math.umit.fmigo-master.arguments", "<x/>")},
        r"arguments of FMIGo's master are not supported",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_followed_is_refused_until_the_user_says_how(make, name):
    """No silent other step: one line with the reason; a step or a master of one's own runs it."""
    places, reason = REFUSED[name]
    path = make(**places)
    order = reason if name != "a hint for one component" else r"wants .*, but .* wants "
    with pytest.raises(
        Problem, match=rf"(?s)^[^\n]*{order}[^\n]*; to choose a way of your own, give --master and"
    ):
        run(path)
    assert run(path, step=0.05).card.steps == 2
    assert run(path, master="jacobi", step=0.05).card.steps == 2


def test_a_step_that_is_none_is_told(make):
    """With line, element, expected and got."""
    path = make(experiment=osp('<osp:FixedStepAlgorithm baseStepSize="0"/>'))
    with pytest.raises(
        Problem,
        match=r"line \d+: FixedStepAlgorithm: expected a positive number of seconds for baseStepSize, got '0'$",
    ):
        load(path)


def test_our_own_annotation_wins(make):
    """It knows more: harvester.ssp carries those of other tools for other tools."""
    ours = '<hc:Coupling xmlns:hc="urn:harvester-cosim:coupling" master="gauss-seidel" step="0.05"/>'
    system = load(make(in_system=oms(FIXED), experiment=annotation("harvester-cosim", ours)))
    assert (system.coupling, system.step) == (Coupling("gauss-seidel"), 0.05)


# ---- slips


def test_an_empty_element_name_is_the_system(make):
    """OMSimulator writes startElement="" for a connector of the system itself."""
    plain, empty = load(make()), load(make(start='startElement="" '))
    assert plain.inputs.keys() == empty.inputs.keys() == {"push"}
    assert plain.connections == empty.connections


def test_an_empty_system_is_told(zip_ssp, capsys):
    """Nothing is run, and no success reported."""
    text = re.sub(r"<ssd:Elements>.*</ssd:Connections>", "<ssd:Elements/>", ssd(), flags=re.S)
    assert main(["run", str(zip_ssp(text, {}))]) == 2
    told = capsys.readouterr().err
    assert told.endswith("SystemStructure.ssd: the system has no components: expected at least one FMU\n")


def test_other_slips_in_the_xml_are_still_told(zip_ssp):
    """Only a prefix that is not declared is let pass."""
    broken = ssd(experiment=osp(BASE, declared="")).replace("</ssd:Elements>", "")
    with pytest.raises(Problem, match=r"SystemStructure\.ssd: is not XML: [^\n]+$"):
        load(zip_ssp(broken, {}))


# ---- broken


@pytest.fixture(scope="module")
def whole(fmus, tmp_path_factory) -> Callable[[str], Path]:
    """Writes an .ssp with all that a file may have, from its changed text."""
    binding = (
        '<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet version="1.0" '
        'name="p"><ssv:Parameters><ssv:Parameter name="a.x2"><ssv:Real value="1" unit="m"/></ssv:Parameter>'
        "</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues><ssd:ParameterMapping><ssm:ParameterMapping "
        f'xmlns:ssm="{SSP}ParameterMapping" version="1.0"><ssm:MappingEntry source="a.x2" target="a.x2">'
        '<ssc:LinearTransformation factor="2"/></ssm:MappingEntry></ssm:ParameterMapping></ssd:ParameterMapping>'
        "</ssd:ParameterBinding></ssd:ParameterBindings>"
    )
    text = ssd(experiment=osp(BASE), in_system=oms(FIXED), bindings=binding)
    parts = {"resources/a.fmu": fmus["mass_a"].read_bytes(), "resources/b.fmu": fmus["mass_b"].read_bytes()}
    path = tmp_path_factory.mktemp("broken") / "system.ssp"

    def write(change: Callable[[str], str]) -> Path:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("SystemStructure.ssd", change(text))
            for name, data in parts.items():
                archive.writestr(name, data)
        return path

    assert load(write(str)).components["a"].start == {"x2": 2.0}
    return write


ODD = ("", "nan", "-1", "x", "1e-300", "http://[::1", "../..", "9" * 30, "é")


@examples(100)
@given(data=st.data())
def test_a_file_with_attributes_lost_or_changed_is_read_or_refused(whole, data):
    """Whatever is missing or odd in it: a system, or one line; never another exception."""

    def change(text: str) -> str:
        for _ in range(data.draw(st.integers(1, 3))):
            places = [m.span() for m in re.finditer(r' [\w:]+="[^"]*"', text)]
            start, end = data.draw(st.sampled_from(places))
            name = text[start:end].partition("=")[0]
            odd = data.draw(st.sampled_from((None, *ODD)))
            text = text[:start] + (f'{name}="{odd}"' if odd is not None else "") + text[end:]
        return text

    path, lines = whole(change), 1
    try:
        load(path)
    except Problem as problem:
        lines = str(problem).count("\n") + 1
    assert lines == 1


def test_a_mapping_with_another_attribute_is_told(whole):
    """As in a file of OMSimulator's tests: line, element, expected and got."""
    with pytest.raises(
        Problem, match=r"line \d+: MappingEntry: expected an attribute target, got source, destination$"
    ):
        load(whole(lambda text: text.replace('source="a.x2" target=', 'source="a.x2" destination=')))
