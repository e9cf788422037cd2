"""SSPs of other tools: annotations about step and master, common faults, units, and broken files."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.properties import examples

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


def named(attributes: str, component: str = 'name="s"') -> dict[str, str]:
    """As OMSimulator's own Python API writes it: a solver of the system, and its name in a component."""

    def information(text: str) -> str:
        inside = f"<oms:SimulationInformation {text}/>"
        return annotation("org.openmodelica", f"<oms:Annotations {OMS}>{inside}</oms:Annotations>")

    return {"in_system": information(f'name="s" {attributes}'), "in_component": information(component)}


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
    "OMSimulator, its Python": (named('method="oms_ma" fixedStepSize="0.02" tolerance="1e-4"'), JACOBI, 0.02),
    "OMSimulator, its Python, steps of its choice": (
        named(
            'method="oms_mav" initialStepSize="0.001" minimumStepSize="0.0001" maximumStepSize="0.05" '
            'relativeTolerance="0.001"'
        ),
        Coupling("jacobi", adaptive=1e-3, smallest=1e-4, largest=0.05),
        0.001,
    ),
    "OMSimulator, its Python, usual steps": (
        named('method="oms_mav2" maximumStepSize="0.01"'),
        Coupling("jacobi", adaptive=1e-4, smallest=1e-12, largest=0.01),
        1e-6,
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
    """As the annotation requests, with a note; without it the step would be that of the FMUs."""
    places, coupling, step = FOLLOWED[name]
    system = load(make(**places))
    assert (system.coupling, system.step, system.refusal) == (coupling, step, "")
    result = run(system)
    assert result.coupling == coupling
    if coupling.adaptive is None:
        assert result.card.steps == 5  # of 0.02 s in 0.1 s
    tool = name.split(",")[0].split()[0]
    several = "the annotation of OMSimulator and the annotation of libcosim"
    wanted = {"draft": "SimulationInformation of a draft of SSP", "two": several}
    said = wanted.get(tool, f"the annotation of {tool}")
    assert [note for note in result.card.notes if note.startswith("coupled")] == [
        f"coupled according to {said} in {system.source}"
    ]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"step": 0.01}, ", except for step"),
        ({"coupling": {"order": 1}}, ", except for order"),
        (
            {"coupling": {"order": 1, "adaptive": 1e-3}, "step": 0.01},
            ", except for order, adaptive, step",
        ),
        ({"coupling": {"master": "jacobi"}}, None),
        ({"master": "hermite"}, None),
        ({"master": "jacobi", "step": 0.02}, None),
    ],
)
def test_the_card_claims_no_more_than_was_followed(make, options, told):
    """The note names given options that replace the annotation; a given master replaces all of it."""
    system = load(make(in_system=oms(FIXED)))
    system = system.coupled(options["coupling"]) if "coupling" in options else system
    own = {name: value for name, value in options.items() if name != "coupling"}
    notes = [note for note in run(system, **own).card.notes if "annotation" in note]
    said = f"coupled according to the annotation of OMSimulator in {system.source}"
    assert notes == ([] if told is None else [said + told])


def test_a_hint_for_one_component_is_named_as_such(make):
    """All components use its step, which the file suggests for one component only."""
    system = load(make(in_component=HINT))
    notes = run(system).card.notes
    source = f"the annotation of libcosim in {system.source}"
    assert f"all components use the step that {source} gives for a" in notes
    assert not any("use the step" in note for note in run(system, step=0.05).card.notes)


def test_a_hint_beside_the_same_step_is_no_other(make):
    """The annotation with the master is followed."""
    system = load(make(in_component=HINT, experiment=osp(BASE.replace("2e-2", "1e-2"))))
    assert (system.coupling, system.step, system.suggestion.components) == (JACOBI, 0.01, ())


SOLVER = '<oms:VariableStepSolver description="cvode" relativeTolerance="0.000100"/>'
SIZES = (
    '<osp:FixedStepAlgorithm baseStepSize="2e-2"><osp:StepSizes><osp:StepSize component="a" multipleOf="2"/>'
    "</osp:StepSizes></osp:FixedStepAlgorithm>"
)
HINT = annotation("com.opensimulationplatform", f'<osp:StepSizeHint {OSP} value="0.01"/>')
REFUSED = {
    "Model Exchange": (
        {"in_system": oms(SOLVER)},
        r"VariableStepSolver of OMSimulator requests Model Exchange \(cvode\)",
    ),
    "a solver of 2026": (
        {
            "in_system": annotation(
                "org.openmodelica",
                f'<oms:SimulationInformation {OMS} name="s" method="euler" tolerance="1e-6"/>',
            )
        },
        r"SimulationInformation of OMSimulator requests Model Exchange \(euler\)",
    ),
    "a method that nobody knows": (
        named('method="oms_mb" fixedStepSize="0.02"'),
        r"the method 'oms_mb' of OMSimulator is not supported",
    ),
    "a step without a method": (
        named('stepSize="0.02"', component=""),
        r"attribute stepSize of SimulationInformation \(OMSimulator\) is not supported",
    ),
    "a step that the method does not read": (
        named('method="oms_mav" fixedStepSize="0.02"'),
        r"attribute fixedStepSize of SimulationInformation \(OMSimulator\) is not supported",
    ),
    "a method without its step": (
        named('method="oms_ma"'),
        r"SimulationInformation: expected an attribute fixedStepSize, got name, method",
    ),
    "a solver that no component names": (
        named('method="oms_ma" fixedStepSize="0.02"', component=""),
        r"no component names the solver 's' of OMSimulator",
    ),
    "a name without a solver": (
        named('method="oms_ma" fixedStepSize="0.02"', component='name="t"'),
        r"no solver of OMSimulator has the name 't'",
    ),
    "a master without its step": (
        {"in_system": oms('<oms:FixedStepMaster description="oms-ma"/>')},
        r"FixedStepMaster: expected an attribute stepSize, got description",
    ),
    "a master without its limits": (
        {"in_system": oms('<oms:VariableStepMaster initialStepSize="0.01" minimumStepSize="0.2"/>')},
        r"VariableStepMaster: expected an attribute maximumStepSize, got initialStepSize, minimumStepSize",
    ),
    "an algorithm without its step": (
        {"experiment": osp("<osp:FixedStepAlgorithm/>")},
        r"FixedStepAlgorithm: expected an attribute baseStepSize, got none",
    ),
    "a misspelt step": (
        {"experiment": osp(BASE.replace("baseStepSize", "basestepsize"))},
        r"FixedStepAlgorithm: expected an attribute baseStepSize, got basestepsize",
    ),
    "a step of another tool's name": (
        {"experiment": osp(BASE.replace("baseStepSize", "stepSize"))},
        r"FixedStepAlgorithm: expected an attribute baseStepSize, got stepSize",
    ),
    "no algorithm": (
        {"experiment": osp("<!-- none -->")},
        r"Algorithm of libcosim: expected a FixedStepAlgorithm, got none",
    ),
    "an algorithm in another place": (
        {"experiment": annotation("com.opensimulationplatform", f"<osp:FixedStepAlgorithm {OSP}/>")},
        r"FixedStepAlgorithm of libcosim is not supported",
    ),
    "sums of signals": (
        {"in_system": annotation("org.open-simulation-platform", f"<osp:Connections {OSP}/>")},
        r"Connections of libcosim is not supported",
    ),
    "a task without its step": (
        {
            "experiment": annotation(
                "com.avl.model.connect.ssp.task", f'<mc:Task {TASK} stepType="parallel"/>'
            )
        },
        r"Task: expected an attribute deltaTime, got stepType",
    ),
    "a task with an end of its own": (
        {
            "experiment": annotation(
                "com.avl.model.connect.ssp.task",
                f'<mc:Task {TASK} deltaTime="0.02" endType="first_component"/>',
            )
        },
        r"endType 'first_component' of OpenMCx is not supported",
    ),
    "extrapolation of a connection": (
        {"in_system": annotation("com.avl.model.connect.ssp.connection.inter_extrapolation", "<x/>")},
        r"annotation com\.avl\.model\.connect\.ssp\.connection\.inter_extrapolation of OpenMCx is not supported",
    ),
    "two masters beside a hint that fits both": (
        {
            "in_component": HINT,
            "in_system": oms(FIXED.replace("0.02", "0.01")),
            "experiment": annotation(
                "com.avl.model.connect.ssp.task", f'<mc:Task {TASK} stepType="sequential" deltaTime="0.01"/>'
            ),
        },
        r"\(OMSimulator\) requests jacobi, step 0\.01 s, but line \d+ \(OpenMCx\) requests gauss-seidel, step 0\.01 s",
    ),
    "constraints": (
        {"in_system": annotation("se.umu.math.umit.ssp.kinematicconstraints", "<x/>")},
        r"annotation se\.umu\.math\.umit\.ssp\.kinematicconstraints of FMIGo is not supported",
    ),
    "a scenario": (
        {"experiment": annotation("com.github.ecos-platform.scenario", "<x/>")},
        r"annotation com\.github\.ecos-platform\.scenario of Ecos is not supported",
    ),
    "another algorithm": (
        {"experiment": osp('<osp:EccoAlgorithm baseStepSize="1"/>')},
        r"EccoAlgorithm of libcosim is not supported",
    ),
    "two that do not agree": (
        {"in_system": oms(FIXED), "experiment": osp(BASE.replace("2e-2", "1e-2"))},
        r"line \d+ \(OMSimulator\) requests jacobi, step 0\.02 s, but line \d+ \(libcosim\) requests jacobi, step 0\.01 s",
    ),
    "a step for one component": (
        {"experiment": osp(SIZES)},
        r"the step of a, 2 times the base step",
    ),
    "a hint for one component": (
        {"experiment": osp(BASE), "in_component": HINT},
        r"requests any master, step 0\.01 s, but",
    ),
    "arguments of a command": (
        {"in_system": annotation("se.umu.math.umit.fmigo-master.arguments", "<x/>")},
        r"annotation se\.umu\.math\.umit\.fmigo-master\.arguments of FMIGo is not supported",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_followed_is_refused_until_the_user_says_how(make, name):
    """One line with the reason; the system runs with a given step or master."""
    places, reason = REFUSED[name]
    path = make(**places)
    order = reason if name != "a hint for one component" else r"requests .*, but .* requests "
    with pytest.raises(Problem, match=rf"(?s)^[^\n]*{order}[^\n]*; --master and --step"):
        run(path)
    for own in ({"step": 0.05}, {"master": "jacobi", "step": 0.05}):
        card = run(path, **own).card
        assert card.steps == 2
        assert [note for note in card.notes if note.startswith("put aside: ")] == [
            f"put aside: {load(path).refusal}"
        ]


@pytest.mark.parametrize(
    "text", ["0", "-0.02", "nan", "INF", "x", "", "0,02", "0_02", "2_0e-3", "\u0660.\u0661"]
)
def test_a_step_that_is_none_is_told_and_can_be_put_aside(make, capsys, text):
    """File, line, element, expected and got; the system runs with a given step, and can be listed."""
    path = make(experiment=osp(f'<osp:FixedStepAlgorithm baseStepSize="{text}"/>'))
    kind = "a positive number of seconds" if text in ("0", "-0.02") else "a finite number"
    told = rf"SystemStructure\.ssd: line \d+: FixedStepAlgorithm: expected {kind} for baseStepSize, got '{text}'; --master"
    with pytest.raises(Problem, match=told):
        run(path)
    assert run(path, master="jacobi", step=0.05).card.steps == 2
    assert main(["signals", str(path)]) == 0
    assert "a.x2" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "got"),
    [
        ({"minimumStepSize": "0.2"}, r"0\.2 s and 0\.05 s"),
        ({"maximumStepSize": "0"}, r"0\.0001 s and 0 s"),
        ({"minimumStepSize": "-1"}, r"-1 s and 0\.05 s"),
    ],
)
def test_limits_of_steps_that_are_none_are_told_and_can_be_put_aside(make, change, got):
    """The message has the line of the annotation."""
    text = VARIABLE
    for name, value in change.items():
        text = re.sub(rf'{name}="[^"]*"', f'{name}="{value}"', text)
    path = make(in_system=oms(text))
    told = (
        rf"ssd: line \d+: VariableStepMaster: smallest and largest step: expected 0 < .*, got {got}; --master"
    )
    with pytest.raises(Problem, match=told):
        run(path)
    assert run(path, master="jacobi", step=0.05).card.steps == 2


@pytest.mark.parametrize(
    ("step", "told"),
    [
        ("0.3", r"expected at most the time from 0 to 0\.1 s, got 0\.3 s"),
        ("1e-300", r"expected at least 1\.39e-14 s, the resolution of the times of the run, got 1e-300 s"),
        ("1e-20", r"expected at least 1\.39e-14 s, the resolution of the times of the run, got 1e-20 s"),
    ],
)
def test_a_step_that_does_not_fit_the_times_is_told_with_its_place(make, step, told):
    """The message has the line of the suggestion, unless the user gives another step."""
    path = make(in_system=oms(FIXED.replace("0.02", step)))
    with pytest.raises(
        Problem, match=rf"ssd: line \d+ \(OMSimulator\): step: {told}; --master and --step override"
    ):
        run(path)
    with pytest.raises(Problem, match=r"^step: expected at most the time from 0 to 0\.1 s, got 0\.4 s$"):
        run(path, step=0.4)
    assert run(path, step=0.05).card.steps == 2


INNER = '<ssd:Component name="inner" type="application/x-ssp-{}" source="resources/inner.{}"/>'


@pytest.fixture(params=["definition", "package"])
def nest(request, fmus, zip_ssp):
    """An .ssp around another file of two masses, an .ssd or an .ssp, both with annotations."""

    def write(outer: dict[str, str], inner: dict[str, str]) -> Path:
        masses = {"a.fmu": fmus["mass_a"], "b.fmu": fmus["mass_b"]}
        part = INNER.format(request.param, "ssd" if request.param == "definition" else "ssp")
        text = ssd(**outer).replace("<ssd:Elements>", f"<ssd:Elements>{part}")
        parts = {f"resources/{name}": fmu for name, fmu in masses.items()}
        if request.param == "definition":
            return zip_ssp(text, {**parts, "resources/inner.ssd": ssd(**inner).replace("resources/", "")})
        return zip_ssp(text, {**parts, "resources/inner.ssp": zip_ssp(ssd(**inner), parts, "inner.ssp")})

    return write


def test_an_annotation_in_a_nested_file_is_followed(nest):
    """The only annotation, or one that agrees with that of the outermost file."""
    for outer in ({}, {"in_system": oms(FIXED)}, {"in_system": oms(FIXED), "experiment": osp(BASE)}):
        system = load(nest(outer, {"in_system": oms(FIXED)}))
        assert (system.coupling, system.step, system.refusal) == (JACOBI, 0.02, "")
        (note,) = (note for note in run(system).card.notes if note.startswith("coupled"))
        assert note.partition("inner.ss")[1]


@pytest.mark.parametrize(
    ("outer", "inner", "told"),
    [
        (
            {"in_system": oms(FIXED)},
            {"in_system": oms(FIXED.replace("0.02", "0.01"))},
            r"inner.*step 0\.01 s",
        ),
        (
            {"in_system": oms(FIXED)},
            {"experiment": osp(BASE.replace("2e-2", "1"))},
            r"inner.*\(libcosim\) requests",
        ),
        (
            {"in_system": oms(FIXED)},
            {"in_system": oms("<oms:VariableStepSolver/>")},
            r"inner.* Model Exchange",
        ),
        (
            {},
            {"in_system": oms(FIXED.replace("0.02", "x"))},
            r"inner.*: FixedStepMaster: expected a finite number",
        ),
    ],
)
def test_an_annotation_in_a_nested_file_that_does_not_fit_is_refused(nest, outer, inner, told):
    """The message names the nested file."""
    path = nest(outer, inner)
    with pytest.raises(Problem, match=told):
        run(path)
    assert run(path, step=0.05).card.steps == 2


def test_our_own_annotation_wins(make):
    """It has more choices; the annotations of other tools in harvester.ssp are for those tools."""
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
    """No FMU is run, and no success is reported."""
    text = re.sub(r"<ssd:Elements>.*</ssd:Connections>", "<ssd:Elements/>", ssd(), flags=re.S)
    assert main(["run", str(zip_ssp(text, {}))]) == 2
    told = capsys.readouterr().err
    assert told.endswith("SystemStructure.ssd: the system has no components: expected at least one FMU\n")


def test_other_slips_in_the_xml_are_still_told(zip_ssp):
    """Only an undeclared prefix is accepted."""
    broken = ssd(experiment=osp(BASE, declared="")).replace("</ssd:Elements>", "")
    with pytest.raises(Problem, match=r"SystemStructure\.ssd: cannot be read as XML: [^\n]+$"):
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
    """For any fault the result is a system or one line, never another exception."""

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
