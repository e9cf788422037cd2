"""Vendor annotations of an SSP that hold the communication step: SSP has no place of its own for it.

Ours also says that the components are stepped one after the other: OMSimulator's and libcosim's stand for
masters that step all at once, and our orchestrator does as they say where ours is not there.
"""

from __future__ import annotations

from lxml import etree

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"
_OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
_OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
_HC = "urn:harvester-cosim:coupling"
# they belong on the root: libcosim takes one on osp:Algorithm for a child
NAMESPACES = {"oms": _OMS, "osp": _OSP, "hc": _HC}


def annotate(system: etree._Element, experiment: etree._Element, step: float) -> None:
    """Write the step [s] for OMSimulator, which opens no system without it, libcosim and ourselves."""
    text = f"{step:.12f}".rstrip("0")  # a decimal for OMSimulator's schema: no exponent
    holder = etree.SubElement(_annotation(system, "org.openmodelica"), f"{{{_OMS}}}Annotations")
    information = etree.SubElement(holder, f"{{{_OMS}}}SimulationInformation")
    master = {"description": "oms-ma", "stepSize": text, "relativeTolerance": "0.0001"}
    etree.SubElement(information, f"{{{_OMS}}}FixedStepMaster", master)
    algorithm = etree.SubElement(
        _annotation(experiment, "com.opensimulationplatform"), f"{{{_OSP}}}Algorithm"
    )
    etree.SubElement(algorithm, f"{{{_OSP}}}FixedStepAlgorithm", baseStepSize=text)
    own = {"master": "gauss-seidel", "step": text}
    etree.SubElement(_annotation(experiment, "harvester-cosim"), f"{{{_HC}}}Coupling", own)


def _annotation(parent: etree._Element, kind: str) -> etree._Element:
    tag = f"{{{_SSP}Description}}Annotations"
    holder = parent.find(tag)
    holder = etree.SubElement(parent, tag) if holder is None else holder
    return etree.SubElement(holder, f"{{{_SSP}Common}}Annotation", type=kind)
