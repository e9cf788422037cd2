"""terminalsAndIcons/terminalsAndIcons.xml of FMI 3.0: the ports of a subsystem, and where its icon goes."""

from __future__ import annotations

from lxml import etree

from fmus.contract import Member, ModelError, Subsystem
from fmus.export.interface import Interface

_SQUARE = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}  # corners of the icon, in its own units
_MILLIMETRES = "0.1"  # the icon is 20 mm wide


def terminals(sub: Subsystem, face: Interface) -> bytes:
    """The XML file; ModelError for a terminal member that is no input or output."""
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    drawing = etree.SubElement(root, "GraphicalRepresentation")
    etree.SubElement(drawing, "CoordinateSystem", _SQUARE, suggestedScalingFactorTo_mm=_MILLIMETRES)
    etree.SubElement(drawing, "Icon", _SQUARE)
    parent = etree.SubElement(root, "Terminals") if sub.terminals else root
    inputs = {v.name for v in face.inputs}
    shown = inputs | {v.name for v in face.variables if v.output}
    for terminal in sub.terminals:
        element = etree.SubElement(
            parent,
            "Terminal",
            name=terminal.name,
            matchingRule="plug",
            terminalKind=f"harvester-cosim.{terminal.kind}",
            description=terminal.text,
        )
        for member in terminal.members:
            if member.variable not in shown:
                raise ModelError(
                    f"{sub.name}: terminal {terminal.name} has the variable {member.variable}, "
                    "expected an input or an output"
                )
            etree.SubElement(
                element,
                "TerminalMemberVariable",
                variableName=member.variable,
                memberName=member.name,
                variableKind=_kind(member),
            )
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def _kind(member: Member) -> str:
    """FMI's kind: what is balanced over a connection flows in or out, the rest is a signal."""
    return f"{member.flow}flow" if member.flow else "signal"
