"""Vendor annotations of an SSP that hold the communication step: SSP 1.0 has no place of its own for it."""

from __future__ import annotations

from lxml import etree

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"
_OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
_OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
NAMESPACES = {"oms": _OMS, "osp": _OSP}  # belong on the root: libcosim takes one on osp:Algorithm for a child


def annotate(system: etree._Element, experiment: etree._Element, step: float) -> None:
    """Write the step [s] for OMSimulator, which opens no system without it, and for libcosim."""
    text = f"{step:.12f}".rstrip("0")  # a decimal for OMSimulator's schema: no exponent
    holder = etree.SubElement(_annotation(system, "org.openmodelica"), f"{{{_OMS}}}Annotations")
    information = etree.SubElement(holder, f"{{{_OMS}}}SimulationInformation")
    master = {"description": "oms-ma", "stepSize": text, "relativeTolerance": "0.0001"}
    etree.SubElement(information, f"{{{_OMS}}}FixedStepMaster", master)
    algorithm = etree.SubElement(
        _annotation(experiment, "com.opensimulationplatform"), f"{{{_OSP}}}Algorithm"
    )
    etree.SubElement(algorithm, f"{{{_OSP}}}FixedStepAlgorithm", baseStepSize=text)


def _annotation(parent: etree._Element, kind: str) -> etree._Element:
    holder = etree.SubElement(parent, f"{{{_SSP}Description}}Annotations")
    return etree.SubElement(holder, f"{{{_SSP}Common}}Annotation", type=kind)
