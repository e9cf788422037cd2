"""What is read of FMI 3.0 and of SSP, element by element: the table in orchestrator/README.md is made here.

python tests/orchestrator/test_standards.py    prints the table
"""

import re
import sys
import zipfile
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1])]  # as a script

from kit.any_fmu.description import packed  # noqa: E402  # after the path of a script
from kit.any_fmu.models import Workshop, bank_fmu, ticking_fmu  # noqa: E402  # after the path of a script
from kit.ssp import bound, connector, inline, real, second, ssd, system, wire  # noqa: E402  # as above

from orchestrator import Problem, assemble, load, run, write_ssp  # noqa: E402  # as above

PAGE = Path(__file__).parents[2] / "orchestrator/README.md"
AT = 'valueReference="400"'
ONE = f'{AT} causality="output" variability="discrete"'
CLOCK = '<Clock name="c" valueReference="{}" causality="local" intervalVariability="triggered"/>'
ANNOTATED = "<ssd:Annotations><ssc:Annotation type='org.any'><any/></ssc:Annotation></ssd:Annotations>"
DATA = '<ssc:MetaData kind="general"><ssc:Content><a/></ssc:Content></ssc:MetaData>'
MAPPED = (
    '<ssc:{0}MappingTransformation><ssc:MapEntry source="{1}" target="{2}"/></ssc:{0}MappingTransformation>'
)
TERMINALS = """<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals>
<Terminal name="port" matchingRule="bus"><TerminalMemberVariable variableName="real" memberName="u"
 variableKind="signal"/></Terminal></Terminals></fmiTerminalsAndIcons>"""
PARAMETER = f'<Float64 name="p" {AT} causality="parameter" variability="fixed" start="1"'
# (element, XML of one more variable of an FMU)
FMI = [
    ("numbers of 8 to 64 bits, Boolean, Enumeration", ""),
    ("String", f'<String name="s" {AT} causality="parameter"><Start value="a"/></String>'),
    ("structural parameter", f'<UInt64 name="n" {AT} causality="structuralParameter" start="2"/>'),
    ("Binary", f'<Binary name="b" {ONE}/>'),
    ("Clock without event mode", CLOCK.format(400)),
    (
        "variable with clocks, without event mode",
        f'<Float64 name="x" {ONE} clocks="401"/>{CLOCK.format(401)}',
    ),
    ("Alias", f'{PARAMETER}><Alias name="q"/></Float64>'),
    (
        "Annotations of an unknown tool",
        f'{PARAMETER}><Annotations><Annotation type="any"/></Annotations></Float64>',
    ),
    ("`declaredType` that is not defined", f'{PARAMETER} declaredType="T"/>'),
    ("`reinit`, `quantity`", f'{PARAMETER} reinit="true" quantity="Length"/>'),
    ("variable of a type that FMI does not have", f'<Float16 name="h" {AT}/>'),
]
UNUSED = (
    *("providesIntermediateUpdate", "canReturnEarlyAfterIntermediateUpdate", "providesAdjointDerivatives"),
    *("providesEvaluateDiscreteStates", "providesPerElementDependencies"),
)
# (element, attributes of CoSimulation)
ABLE = [
    ("early return without event mode: not used", {"mightReturnEarlyFromDoStep": "true"}),
    (f"{', '.join(f'`{name}`' for name in UNUSED)}: not used", dict.fromkeys(UNUSED, "true")),
    ("output derivatives of order 2: those of order 1 are used", {"maxOutputDerivativeOrder": 2}),
    ("`needsExecutionTool`", {"needsExecutionTool": "true"}),
]
# (element, files in the archive)
FILES = [
    ("terminals and icons", {"terminalsAndIcons/terminalsAndIcons.xml": TERMINALS}),
    (
        "layered standard",
        {"extra/org.fmi-standard.fmi-ls-xcp/fmi-ls-manifest.xml": "<fmiLayeredStandardManifest/>"},
    ),
]


def part(connectors="", more="", tag="Component", attributes='source="g.fmu"'):
    """A component with what one probe adds to its connectors and to itself."""
    ends = '<ssd:Connector name="u" kind="input"/><ssd:Connector name="y" kind="output"/>' + connectors
    return f'<ssd:{tag} name="a" {attributes}><ssd:Connectors>{ends}</ssd:Connectors>{more}</ssd:{tag}>'


def typed(kind, dimension="", name="t", way="input"):
    """A connector that the FMU does not have."""
    return f'<ssd:Connector name="{name}" kind="{way}"><ssc:{kind}/>{dimension}</ssd:Connector>'


SIZED = '<ssc:Dimension size="3"/>'
INLET = connector("command", "input", "m")


def bank(*wires, more=""):
    """A file with an FMU of arrays, see bank.c."""
    ends = typed("Float64", SIZED, "u") + typed("Float64", "<ssc:Dimension/>", "y", "output")
    component = f'<ssd:Component name="a" source="bank.fmu"><ssd:Connectors>{ends}</ssd:Connectors>{more}'
    inlets = INLET + typed("Float64", SIZED, "w")
    return ssd(system([f"{component}</ssd:Component>"], wires, inlets))


def one(*wires, **more):
    """A file with one component."""
    return ssd(system([part(**more)], wires, INLET))


EXCEL = 'source="p.xlsx" type="application/vnd.ms-excel"'
TIMES_TWO = '<ssc:LinearTransformation factor="2"/>'
BUS = {"come": ("Clock", "input"), "data": ("Binary", "input"), "fired": ("Clock", "output")}


def bus(*wires):
    """A file with two nodes of a bus, see ticks.c."""
    names = {**BUS, "frame": ("Binary", "output")}
    ends = "".join(typed(kind, "", name, way) for name, (kind, way) in names.items())
    parts = [
        f'<ssd:Component name="{n}" source="unit.fmu"><ssd:Connectors>{ends}</ssd:Connectors></ssd:Component>'
        for n in "ab"
    ]
    return ssd(system(parts, wires))


LISTS = inline(
    ("m", '<ssv:Float64 value="1 0 0 1"/>'),
    ("k", '<ssv:Float64 value="1 2"/>'),
    ("n", '<ssv:UInt64 value="2"/>'),
    ("u", '<ssv:Float64 value="1 2"/>'),
)
VALUES = ('<ssv:Float64 value="1 2"/>', '<ssv:Binary value="ff"/>')
# (element, text of the .ssd)
SSP = [
    ("FMU, inner system, SSP or .ssd as a component", one()),
    ("ParameterBinding, ParameterMapping", one(more=inline(real("offset", 2)))),
    ("LinearTransformation", one(wire("command", "a.u", TIMES_TWO))),
    ("mapping of values, at a Real", one(wire("command", "a.u", MAPPED.format("Integer", 1, 2)))),
    ("geometry", one(more='<ssd:ElementGeometry x1="0" y1="0" x2="1" y2="1"/>')),
    ("Annotation of an unknown tool", ssd(system([part()], []), ANNOTATED)),
    ("MetaData, Signature", one(more=DATA)),
    ("connector of kind `inout`", one(connectors=typed("Float64", way="inout"))),
    ("connector with Dimension, connected whole", bank(wire("w", "a.u"))),
    ("of another size than that of the FMU", bank(wire("a.y", "a.u"))),
    ("`startIndices`, `endIndices`", bank(wire("command", "a.u", extra='endIndices="2"'))),
    ("connectors of types Clock and Binary", bus(wire("a.fired", "b.come"), wire("a.frame", "b.data"))),
    ("Binary of a clock that nothing ticks", bus(wire("a.frame", "b.data"))),
    ("list of values for an array, with its size", bank(more=LISTS)),
    ("list of values for a scalar", one(more=inline(("offset", VALUES[0])))),
    ("Binary as a parameter's value", one(more=inline(("offset", VALUES[1])))),
    ("parameters in another format", one(more=bound(EXCEL))),
    ("component of another type", one(attributes='source="g.jar" type="application/java"')),
    ("`ScheduledExecution`", one(attributes='source="g.fmu" implementation="ScheduledExecution"')),
    ("element of no SSP", one(more="<ssd:Banana/>")),
    ("version 3.0", one()),
]


def outcome(path):
    """What a user sees: the line of a refusal, or the notes; without paths and numbers of lines."""
    try:
        result = run(load(path), step=0.5, stop=1.5, isolate=False)
    except Problem as problem:
        return f"refused: {line(problem)}"
    told = [line(note) for note in (*result.card.warnings, *result.card.notes)]
    return "; ".join(f"note: {text}" for text in dict.fromkeys(told)) or "read"


def line(said):
    """Its first line without the names of files and parts."""
    text = re.sub(r"\S*/", "", str(said).splitlines()[0])
    text = text.replace("|", "\\|").removeprefix("system.ssp: ").replace("SystemStructure.ssd: ", "")
    text = re.sub(r"^(p\d+\.fmu|p\d+|a|system|top): ", "", text)
    return re.sub(r"^line \d+: ", "", text)


def table(folder):
    """The rows of the table, from a run of every probe."""
    workshop = Workshop(folder).other(3)
    rows = ["|standard|element|what happens|", "|---|---|---|"]
    arrays = bank_fmu(folder / "bank.fmu")
    rows.append(f"|FMI 3.0|array, also as state, event indicator or matrix|{outcome(arrays)}|")
    for interval in ("constant", "fixed", "tunable", "changing", "countdown"):
        attributes = f'intervalVariability="{interval}"' + ' intervalDecimal="0.1"' * (
            interval != "countdown"
        )
        clocks = outcome(ticking_fmu(folder / "unit.fmu", attributes))
        rows.append(f"|FMI 3.0|{interval} and triggered Clock, with event mode|{clocks}|")
    clocks = outcome(units := ticking_fmu(folder / "unit.fmu", 'intervalVariability="fixed"'))
    rows.append(f"|FMI 3.0|fixed Clock whose interval and shift the FMU tells|{clocks}|")
    scheduled = outcome(workshop.make("types", "scheduled", kind="ScheduledExecution"))
    rows.append(f"|FMI 3.0|Scheduled Execution only, as Clocks of the Reference-FMUs|{scheduled}|")
    for n, (element, more) in enumerate(FMI):
        rows.append(f"|FMI 3.0|{element}|{outcome(workshop.make('types', f'p{n}', more=more))}|")
    for element, able in ABLE:
        rows.append(f"|FMI 3.0|{element}|{outcome(workshop.make('types', 'able', able=able))}|")
    for element, extra in FILES:
        rows.append(f"|FMI 3.0|{element}|{outcome(workshop.make('types', 'files', extra=extra))}|")
    for n, (element, text) in enumerate(SSP):
        (folder / f"{n}").mkdir()
        version = 3 if "version 3" in element else 2
        edition = second(text).replace('version="2.0" name', f'version="{version}.0" name', 1)
        parts = {"SystemStructure.ssd": edition, "g.fmu": workshop["gain"].read_bytes()}
        parts |= {"bank.fmu": arrays.read_bytes(), "unit.fmu": units.read_bytes()}
        rows.append(f"|SSP 2.0|{element}|{outcome(packed(folder / f'{n}' / 'system.ssp', parts))}|")
    sizes = '<ssc:Dimension size="2"/>'
    wired = assemble({"a": arrays, "b": arrays}, ["a.y -> b.u"], {"b.n": 2, "b.k": "1 2", "b.m": "1 0 0 1"})
    file = write_ssp(wired, folder / "written.ssp")
    text = zipfile.ZipFile(file).read("SystemStructure.ssd").decode()
    written = f"{outcome(file)}, with Dimension" if text.count(sizes) == 3 else outcome(file)
    rows.append(f"|SSP 2.0|a file that is written, with arrays|{written}|")
    return "\n".join(rows)


def test_the_table_of_the_page_is_what_happens(tmp_path):
    """Each element is read, left out with a note, or refused in one line that names it."""
    assert table(tmp_path) in PAGE.read_text("utf-8")


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        print(table(Path(place)))
