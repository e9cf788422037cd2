"""Texts of SSP files: systems, components, connectors, connections and parameter bindings."""

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="test"
 xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
 xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
 xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping">
"""
UNITS = """<ssd:Units>
<ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>
<ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>
<ssc:Unit name="N"><ssc:BaseUnit kg="1" m="1" s="-2"/></ssc:Unit>
</ssd:Units><ssd:DefaultExperiment startTime="0.5" stopTime="1.5"/>"""
TAIL = "</ssd:SystemStructureDescription>"


def ssd(system, tail=UNITS):
    return HEAD + system + tail + TAIL


def gain(name, bindings="", source="resources/gain.fmu"):
    return f"""<ssd:Component name="{name}" source="{source}"><ssd:Connectors>
<ssd:Connector name="u" kind="input"/><ssd:Connector name="y" kind="output"/></ssd:Connectors>
{bindings}</ssd:Component>"""


def real(name, value, unit=""):
    """A parameter and its value, for `inline`."""
    return name, f'<ssv:Real value="{value}" {unit and f"unit={unit!r}"}/>'


def bound(attributes, inside=""):
    binding = f"<ssd:ParameterBinding {attributes}>{inside}</ssd:ParameterBinding>"
    return f"<ssd:ParameterBindings>{binding}</ssd:ParameterBindings>"


def inline(*parameters, prefix=""):
    values = "".join(f'<ssv:Parameter name="{n}">{v}</ssv:Parameter>' for n, v in parameters)
    text = f"""<ssd:ParameterValues><ssv:ParameterSet version="1.0" name="p"><ssv:Parameters>{values}
</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues>"""
    return bound(f'prefix="{prefix}"', text)


def wire(start, end, inner="", extra=""):
    def ends(side, port):
        element, _, connector = port.rpartition(".")
        return (f'{side}Element="{element}" ' if element else "") + f'{side}Connector="{connector}"'

    return f"<ssd:Connection {ends('start', start)} {ends('end', end)} {extra}>{inner}</ssd:Connection>"


def system(elements, wires, connectors="", bindings="", name="top"):
    joined = f"<ssd:Connections>{''.join(wires)}</ssd:Connections>" if wires else ""
    head = f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else ""
    return f"""<ssd:System name="{name}">{head}{bindings}
<ssd:Elements>{"".join(elements)}</ssd:Elements>{joined}</ssd:System>"""


def connector(name, kind, unit="", type_="Real"):
    declared = f"<ssc:{type_} {unit and f'unit={unit!r}'}/>"
    return f'<ssd:Connector name="{name}" kind="{kind}">{declared}</ssd:Connector>'


def second(text):
    """Text of an SSP 1.0 as SSP 2.0, with the type names of FMI 3.0."""
    text = text.replace('version="1.0" name', 'version="2.0" name')
    return text.replace(":Real", ":Float64").replace("<Real", "<Float64")
