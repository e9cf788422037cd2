"""Faults that are planted in the valid FMUs: one change each, and the rule that must report it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from check.good import DESCRIPTION, XML_2, Archive

Break = Callable[[Archive], Archive]


@dataclass(frozen=True)
class Fault:
    """One planted fault: only `rule` must report it; the message of the finding must contain `text`."""

    name: str
    rule: str
    break_: Break
    text: str = ""
    major: int = 2
    severity: str = "error"

    def __str__(self) -> str:
        return f"{self.name}-{self.major}"


def xml(old: str, new: str) -> Break:
    """Replace text in modelDescription.xml."""
    return lambda a: a.swap(old, new)


def put(name: str, content: bytes | str) -> Break:
    """Add a member, or replace its content."""
    return lambda a: a.put(name, content)


def drop(*starts: str) -> Break:
    """Remove members."""
    return lambda a: a.drop(*starts)


def both(*breaks: Break) -> Break:
    """Several changes that together are one fault."""

    def all_(a: Archive) -> Archive:
        for break_ in breaks:
            a = break_(a)
        return a

    return all_


def variable(inner: str, name: str = "extra", reference: int = 9, **values: str) -> Break:
    """Add a variable at the end of the FMI 2 file."""
    attributes = "".join(f' {k}="{v}"' for k, v in {"description": "More", **values}.items())
    text = f'<ScalarVariable name="{name}" valueReference="{reference}"{attributes}>{inner}</ScalarVariable>'
    return xml("</ModelVariables>", f"{text}\n</ModelVariables>")


U = 'name="u" valueReference="1" causality="input"'
UNIT_U = '<Real unit="Pa" displayUnit="bar"'
INPUT = '<Real unit="Pa" displayUnit="bar" start="0" min="0" max="1e8" nominal="1e7"/>'
OUTPUTS = '<Outputs><Unknown index="6" dependencies="4" dependenciesKind="constant"/></Outputs>'
INITIAL = '<Unknown index="5" dependencies="2 3 4"/><Unknown index="6" dependencies="4"/></InitialUnknowns>'
CS = '<CoSimulation modelIdentifier="lag"'
ME = '<ModelExchange modelIdentifier="lag"'
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
BUILD = "sources/buildDescription.xml"
STRUCTURED = xml('variableNamingConvention="flat"', 'variableNamingConvention="structured"')


def _calls(old: str, new: str) -> Break:
    return xml(f'name="{old}"', f'name="{new}"')


PORTS = "".join(
    f'<Float64 name="u{i}" valueReference="{i}" causality="input" unit="Pa" start="0" description="More"/>'
    for i in range(10, 19)
)
SIMULATION_3 = """<CoSimulation modelIdentifier="lag" canHandleVariableCommunicationStepSize="true" maxOutputDerivativeOrder="1"
 canGetAndSetFMUState="true" canSerializeFMUState="true" providesDirectionalDerivatives="true"/>"""
EXCHANGE_3 = """<ModelExchange modelIdentifier="lag" canGetAndSetFMUState="true" canSerializeFMUState="true"
 providesDirectionalDerivatives="true"/>"""


FILE_FAULTS = [
    Fault("backslash", "archive.name", put("resources\\a.csv", "1"), "backslash"),
    Fault("climbs out", "archive.name", put("../../evil.txt", "1"), "'..' in its path"),
    Fault("absolute", "archive.name", put("/etc/evil", "1"), "absolute"),
    Fault("drive", "archive.name", put("C:/evil", "1"), "absolute"),
    Fault("case twins", "archive.twice", put("documentation/Index.html", "1"), "only by case"),
    Fault("spaces", "archive.path", put("resources/my table.csv", "1"), "spaces", severity="warning"),
    Fault("umlaut", "archive.path", put("resources/kühl.csv", "1"), "non-ASCII", severity="warning"),
    Fault("too long for Windows", "archive.path", put(f"resources/{'x' * 160}.csv", "1"), "Windows", severity="warning"),
    Fault("no module of WebAssembly", "platform.wasm", put("binaries/wasm32-wasip1/log.wasm", "1"), "expected lag.wasm"),
    Fault("another format", "platform.wasm", put("binaries/wasm32-wasip1/lag.wasm", "12345678"), "got another format", 3),
    Fault("module for a component", "platform.wasm", put("binaries/wasm32-wasip2/lag.wasm", "\0asm\1\0\0\0"), "expected a WebAssembly component, got module", 3),
    Fault("stray file", "archive.stray", put("build.log", "1"), "build.log", severity="note"),
    Fault("extra without domain", "archive.extra", put("extra/mine/a.txt", "1"), "mine", severity="note"),
    Fault("no icon", "contents.icon", drop("model.png", "terminalsAndIcons/icon.png"), "model.png", severity="note"),
    Fault("no icon", "contents.icon", drop("terminalsAndIcons/icon.png"), "icon.png", 3, "note"),
    Fault("no documentation", "contents.documentation", drop("documentation/index.html"), "index.html", severity="note"),
    Fault("no licence", "contents.licence", both(drop("documentation/licenses"), xml(' license="MIT"', "")), "licence", severity="note"),
    Fault("path of the machine", "contents.paths", put("documentation/notes.txt", "a\nsee /home/anna/model.mo"), "notes.txt line 2", severity="warning"),
    Fault("path of Windows", "contents.paths", xml("A first-order lag", "From C:\\Users\\anna\\lag.mo"), "line 2", severity="warning"),
    Fault("svg icon only", "terminal.icons", both(drop("terminalsAndIcons/icon.png"), put("terminalsAndIcons/icon.svg", "<svg/>")), "icon.svg"),
    Fault("script that cannot be read", "python.syntax", put("resources/model.py", "def f(:"), "model.py"),
    Fault("sources named all.c", "source.name", both(put("sources/all.c", ""), lambda a: a.swap('name="lag.c"', 'name="all.c"', BUILD)), "lag.c", 3, "note"),
    Fault("many ports, no terminals", "terminal.exists", both(drop(TERMINALS), xml("</ModelVariables>", PORTS + "</ModelVariables>")), "one by one", 3, "note"),
    Fault("Java", "runtime.java", put("resources/model.jar", "1"), "Java", severity="warning"),
    Fault("source missing", "source.listed", xml("</SourceFiles></ModelExchange>", '<File name="gone.c"/></SourceFiles></ModelExchange>'), "gone.c"),
    Fault("no source list", "source.build", drop(BUILD), "buildDescription.xml", 3),
    Fault("source missing", "source.listed", lambda a: a.swap("</SourceFileSet>", '<SourceFile name="gone.c"/></SourceFileSet>', BUILD), "gone.c", 3),
    Fault("sources of another model", "source.description", lambda a: a.swap('modelIdentifier="lag"', 'modelIdentifier="log"', BUILD), "log", 3),
    Fault("build description of FMI 3.1", "source.description", lambda a: a.swap('fmiVersion="3.0"', 'fmiVersion="3.1"', BUILD), "3.1", 3),
    Fault("headers of FMI", "source.headers", put("sources/fmi2Functions.h", "1"), "FMI headers", severity="note"),
    Fault("unknown member", "terminal.members", lambda a: a.swap('variableName="u"', 'variableName="v"', TERMINALS), "'v'", 3),
    Fault("member is local", "terminal.members", lambda a: a.swap('variableName="u"', 'variableName="x"', TERMINALS), "got local", 3),
    Fault("member twice", "terminal.names", lambda a: a.swap('memberName="set"', 'memberName="pressure"', TERMINALS), "2 members", 3),
    Fault("member without name", "terminal.names", lambda a: a.swap(' memberName="set"', "", TERMINALS), "no memberName", 3),
    Fault("matching rule", "terminal.rule", lambda a: a.swap('"plug"', '"socket"', TERMINALS), "socket", 3),
    Fault("terminals break schema", "terminal.schema", lambda a: a.swap(' variableKind="signal"/>\n</Terminal>', "/>\n</Terminal>", TERMINALS), "variableKind", 3),
]  # fmt: skip

XML_FAULTS = [
    Fault("not XML", "xml.syntax", put(DESCRIPTION, "<fmiModelDescription"), "cannot be read as XML"),
    Fault("document type", "xml.syntax", xml("<fmiModelDescription ", '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>\n<fmiModelDescription '), "document type"),
    Fault("other root", "xml.syntax", put(DESCRIPTION, "<html/>"), "html"),
    Fault("encoding", "xml.encoding", put(DESCRIPTION, XML_2.replace('"UTF-8"', '"ISO-8859-1"')), "ISO-8859-1"),
    Fault("FMI 1", "version.known", put(DESCRIPTION, '<fmiModelDescription fmiVersion="1.0"/>'), "not supported"),
    Fault("FMI 4", "version.known", put(DESCRIPTION, '<fmiModelDescription fmiVersion="4.0"/>'), "4.0"),
    Fault("schema: unknown attribute", "xml.schema", xml(CS, f'{CS} stepSize="1"'), "stepSize"),
    Fault("schema: unknown attribute", "xml.schema", xml('name="u"', 'name="u" colour="red"'), "colour", 3),
    Fault("schema: unknown element", "xml.schema", xml("<LogCategories>", "<Colours/><LogCategories>"), "Colours"),
    Fault("empty GUID", "identity.token", xml("{31f3d6a2-6f0c-4b57-9d7e-0c1f6a5e9b42}", ""), "empty"),
    Fault("empty token", "identity.token", xml("{9a0c6f5e-2a31-4f0e-8f57-6d1b7b6b3c55}", ""), "empty", 3),
    Fault("GUID of an example", "identity.token", xml("{31f3d6a2-6f0c-4b57-9d7e-0c1f6a5e9b42}", "{8c4e810f-3df3-4a00-8276-176fa3c9f003}"), "example", severity="warning"),
    Fault("nil GUID", "identity.token", xml("{31f3d6a2-6f0c-4b57-9d7e-0c1f6a5e9b42}", "{00000000-0000-0000-0000-000000000000}"), "nil", severity="warning"),
    Fault("GUID lacks a brace", "identity.token", xml("-0c1f6a5e9b42}", "-0c1f6a5e9b42"), "brace", severity="warning"),
    Fault("Outputs lack one", "structure.outputs", xml(OUTPUTS, ""), "lacks y"),
    Fault("Outputs have too many", "structure.outputs", xml(OUTPUTS, OUTPUTS.replace("</O", '<Unknown index="4" dependencies=""/></O')), "has x"),
    Fault("Outputs lack one", "structure.outputs", xml('<Output valueReference="5" dependencies="3" dependenciesKind="constant"/>', ""), "lacks y", 3),
    Fault("InitialUnknowns lack one", "structure.initial", xml(INITIAL, INITIAL.replace('<Unknown index="5" dependencies="2 3 4"/>', "")), "lacks der_x"),
    Fault("InitialUnknowns have too many", "structure.initial", xml(INITIAL, '<Unknown index="4" dependencies=""/>' + INITIAL), "has x"),
    Fault("InitialUnknown lacks one", "structure.initial", xml('<InitialUnknown valueReference="5" dependencies="3"/>\n', ""), "lacks y", 3),
    Fault("InitialUnknowns out of order", "structure.entries", xml(INITIAL, '<Unknown index="6" dependencies="4"/><Unknown index="5" dependencies="2 3 4"/></InitialUnknowns>'), "order", severity="warning"),
    Fault("unknown twice", "structure.entries", xml(OUTPUTS, OUTPUTS.replace("<Outputs>", '<Outputs><Unknown index="6" dependencies="4"/>')), "got 2"),
    Fault("unknown of no variable", "structure.entries", xml(INITIAL, INITIAL.replace("</I", '<Unknown index="77"/></I')), "77"),
    Fault("derivative of nothing", "structure.derivatives", xml(' derivative="4"', ""), "no attribute derivative"),
    Fault("derivative of an input", "structure.rates", variable('<Real unit="Pa/s" start="0" derivative="2"/>', "u_rate", causality="input"), "count a state for each: u_rate", severity="warning"),
    Fault("derivative of an output", "structure.rates", both(variable('<Real unit="Pa/s" derivative="4"/>', "x_rate", causality="output"), xml(OUTPUTS, OUTPUTS.replace("</O", '<Unknown index="7" dependencies="4"/></O')), xml(INITIAL, INITIAL.replace("</I", '<Unknown index="7" dependencies="4"/></I'))), "no entry in ModelStructure/Derivatives; some tools count a state for each: x_rate", severity="warning"),
    Fault("derivative of nothing", "structure.derivatives", xml(' derivative="3"', ' derivative="33"'), "33", 3),
    Fault("no dependencies", "structure.dependencies", xml(OUTPUTS, '<Outputs><Unknown index="6"/></Outputs>'), "feed-through", severity="warning"),
    Fault("no dependencies", "structure.dependencies", xml(' dependencies="3" dependenciesKind="constant"', ""), "feed-through", 3, "warning"),
    Fault("depends on an output", "structure.knowns", xml('<Unknown index="5" dependencies="2 3 4"/>', '<Unknown index="5" dependencies="2 3 4 6"/>'), "y is output", severity="warning"),
    Fault("depends on a parameter while running", "structure.knowns", xml('dependencies="2 4" dependenciesKind="fixed fixed"', 'dependencies="2 3 4"'), "rate is parameter", severity="note"),
    Fault("depends on nothing known", "structure.knowns", xml('<Unknown index="6" dependencies="4"/></I', '<Unknown index="6" dependencies="4 99"/></I'), "99"),
    Fault("too few kinds", "structure.kinds", xml('dependenciesKind="fixed fixed"', 'dependenciesKind="fixed"'), "got 1"),
    Fault("kinds without dependencies", "structure.kinds", xml('<Unknown index="6" dependencies="4"/></I', '<Unknown index="6" dependenciesKind="dependent"/></I'), "without"),
    Fault("kind not allowed initially", "structure.kinds", xml('<Unknown index="6" dependencies="4"/></I', '<Unknown index="6" dependencies="4" dependenciesKind="fixed"/></I'), "fixed"),
    Fault("name twice", "variable.duplicate", variable("<Real/>", "rate"), "rate is also in line"),
    Fault("output is fixed", "variable.combination", xml('causality="output"', 'causality="output" variability="fixed"'), "fixed"),
    Fault("input with initial", "variable.combination", xml(U, f'{U} initial="exact"'), "expected none"),
    Fault("parameter is continuous", "variable.combination", xml(' variability="fixed" unit="1/s"', ' variability="continuous" unit="1/s"'), "continuous", 3),
    Fault("continuous integer", "variable.combination", variable("<Integer/>", variability="continuous"), "Integer"),
    Fault("integer without variability", "variable.variability", variable("<Integer/>"), "by default", severity="warning"),
    Fault("input without start", "variable.start", xml(UNIT_U + ' start="0"', UNIT_U), "expected a start value"),
    Fault("input without start", "variable.start", xml('displayUnit="bar" start="0"', 'displayUnit="bar"'), "expected a start value", 3),
    Fault("calculated with start", "variable.start", xml('<Real unit="Pa/s"', '<Real unit="Pa/s" start="1"'), "expected no start value"),
    Fault("same value reference", "variable.reference", xml("</ModelVariables>", '<Float64 name="z" valueReference="5"/></ModelVariables>'), "that of y", 3),
    Fault("alias with another unit", "variable.alias", variable('<Real unit="Pa/s"/>', reference=3), "unit"),
    Fault("two settable aliases", "variable.alias", variable('<Real unit="Pa" start="0"/>', reference=1, causality="parameter", variability="fixed"), "both can be set"),
    Fault("no independent variable", "variable.independent", xml('<Float64 name="time" valueReference="0" causality="independent" unit="s" description="Time"/>', ""), "no independent", 3),
    Fault("two independent variables", "variable.independent", variable("<Real/>", causality="independent"), "second"),
    Fault("declared type missing", "variable.type", variable('<Real declaredType="Colour"/>'), "Colour"),
    Fault("declared type of another type", "variable.type", variable('<Real declaredType="Gear"/>'), "Gear has the type Enumeration"),
    Fault("string parameter as input", "variable.string", variable('<String start="a"/>', causality="input", variability="discrete"), "String", severity="note"),
    Fault("no description", "variable.text", xml(' description="Set pressure"', ""), "u", severity="note"),
    Fault("start is infinite", "value.start", xml('<Real unit="1/s" start="2"', '<Real unit="1/s" start="INF"'), "finite", severity="warning"),
    Fault("start below min", "value.range", xml(INPUT, INPUT.replace('start="0"', 'start="-5"')), "-5 is outside"),
    Fault("min above max", "value.range", xml(INPUT, INPUT.replace('min="0"', 'min="2e8"')), "above"),
    Fault("nominal 0", "value.nominal", xml('nominal="1e7"', 'nominal="0"'), "got 0", severity="warning"),
    Fault("no such item", "value.enumeration", variable('<Enumeration declaredType="Gear" start="3"/>', causality="parameter", variability="fixed"), "got 3"),
    Fault("unit not defined", "unit.undefined", xml('<Real unit="1/s"', '<Real unit="Hz"'), "Hz"),
    Fault("unit not defined", "unit.undefined", xml(' unit="1/s"', ' unit="Hz"'), "Hz", 3),
    Fault("display unit not defined", "unit.display", xml('displayUnit="bar"', 'displayUnit="psi"'), "psi"),
    Fault("display unit without unit", "unit.display", variable('<Real displayUnit="bar"/>'), "without unit"),
    Fault("no base unit", "unit.base", xml('<Unit name="1/s"><BaseUnit s="-1"/></Unit>', '<Unit name="1/s"/>'), "1/s", severity="warning"),
    Fault("unit twice", "unit.twice", xml("</UnitDefinitions>", '<Unit name="s"><BaseUnit s="1"/></Unit></UnitDefinitions>'), "2 times", severity="warning"),
    Fault("pascal of another dimension", "unit.wrong", xml('<BaseUnit kg="1" m="-1" s="-2"/>', '<BaseUnit kg="1" m="1" s="-2"/>'), "unit Pa"),
    Fault("second with a factor", "unit.wrong", xml('<Unit name="s"><BaseUnit s="1"/>', '<Unit name="s"><BaseUnit s="1" factor="60"/>'), "got 60"),
    Fault("port not in SI", "unit.factor", both(xml("</UnitDefinitions>", '<Unit name="psi"><BaseUnit kg="1" m="-1" s="-2" factor="6894.757"/></Unit></UnitDefinitions>'), xml('description="Pressure">\n<Real unit="Pa"/>', 'description="Pressure">\n<Real unit="psi"/>')), "psi", severity="note"),
    Fault("no unit", "unit.missing", xml('<Real unit="1/s" start="2"', '<Real start="2"'), "rate", severity="note"),
    Fault("breaks the grammar", "name.grammar", both(STRUCTURED, _calls("rate", "rate of change")), "rate of change"),
    Fault("structured names of ports", "name.structured", both(STRUCTURED, _calls("y", "port.y"), lambda a: a.swap('variableName="y"', 'variableName="port.y"', TERMINALS)), "port.y", severity="note"),
    Fault("no identifier", "name.characters", _calls("rate", "2 rate"), "2 rate", severity="note"),
    Fault("differ by case", "name.case", variable("<Real/>", "Rate"), "Rate", severity="note"),
    Fault("keyword", "name.keyword", _calls("rate", "when"), "Modelica", severity="warning"),
    Fault("keyword of both", "name.keyword", _calls("rate", "for"), "Modelica and C", severity="warning"),
    Fault("too long for MATLAB", "name.length", _calls("rate", "r" * 64), "64", severity="note"),
    Fault("same after mangling", "name.mangled", both(STRUCTURED, _calls("rate", "a.b"), variable("<Real/>", "a_b")), "a_b", severity="note"),
    Fault("once per process", "ability.once", xml(CS, f'{CS} canBeInstantiatedOnlyOncePerProcess="true"'), "CoSimulation", severity="warning"),
    Fault("needs its tool", "ability.tool", xml(CS, f'{CS} needsExecutionTool="true"'), "licence", severity="warning"),
    Fault("no state", "ability.state", xml('maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true" canSerializeFMUstate="true"', 'maxOutputDerivativeOrder="1"'), "cannot be saved", severity="note"),
    Fault("serialises what it cannot get", "ability.state", xml('maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true"', 'maxOutputDerivativeOrder="1"'), "without"),
    Fault("no serialisation", "ability.serialize", xml('maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true" canSerializeFMUstate="true"', 'maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true"'), "serialised", severity="note"),
    Fault("no derivatives", "ability.derivatives", xml(' canSerializeFMUState="true" providesDirectionalDerivatives="true"/>\n<Unit', ' canSerializeFMUState="true"/>\n<Unit'), "directional", 3, "note"),
    Fault("fixed step", "ability.step", xml(' canHandleVariableCommunicationStepSize="true"', ""), "vary", severity="note"),
    Fault("no output derivatives", "ability.signal_derivatives", xml(' maxOutputDerivativeOrder="1"', ""), "output derivatives", severity="note"),
    Fault("asynchronous", "ability.asynchronous", xml(CS, f'{CS} canRunAsynchronuously="true"'), "pending", severity="note"),
    Fault("no experiment", "experiment.exists", xml('<DefaultExperiment startTime="0" stopTime="10" tolerance="1e-6" stepSize="0.01"/>', ""), "guess", severity="note"),
    Fault("stops before it starts", "experiment.values", xml('stopTime="10"', 'stopTime="-1"'), "expected a time after"),
    Fault("never stops", "experiment.values", xml('stopTime="10"', 'stopTime="INF"'), "expected a time after"),
    Fault("step of 0", "experiment.values", xml('stepSize="0.01"', 'stepSize="0"'), "stepSize: expected a positive number, got 0"),
    Fault("step longer than all", "experiment.values", xml('stepSize="0.01"', 'stepSize="20"'), "longer", severity="warning"),
    Fault("step that does not fit", "experiment.step", xml('stepSize="0.01"', 'stepSize="0.3"'), "steps", severity="note"),
    Fault("starts late", "experiment.start", xml('startTime="0"', 'startTime="1"'), "startTime is 1", severity="note"),
    Fault("no author", "contents.texts", xml(' author="tests"', ""), "author", severity="note"),
    Fault("no log categories", "contents.categories", xml('<LogCategories><Category name="logStatusError"/></LogCategories>', ""), "no log categories", severity="note"),
    Fault("log category twice", "contents.categories", xml("<LogCategories>", '<LogCategories><Category name="logStatusError"/>'), "2 times", severity="warning"),
    Fault("vendor annotations", "contents.annotations", xml("<ModelVariables>", '<VendorAnnotations><Tool name="Other"><a/></Tool></VendorAnnotations><ModelVariables>'), "Other", severity="note"),
    Fault("no Co-Simulation", "kind.simulation", xml(SIMULATION_3, ""), "no Co-Simulation", 3, "note"),
    Fault("no Model Exchange", "kind.exchange", xml(EXCHANGE_3, ""), "no Model Exchange", 3, "note"),
    Fault("array", "variable.array", xml("</ModelVariables>", '<Float64 name="a" valueReference="9"><Dimension start="2"/></Float64></ModelVariables>'), "a is an array", 3, "note"),
    Fault("neither kind", "kind.some", put(DESCRIPTION, XML_2.partition(ME)[0] + "<UnitDefinitions>" + XML_2.partition("<UnitDefinitions>")[2]), "neither"),
]  # fmt: skip
