"""Files of the layered standard FMI-LS-REF (draft 1.0.0-alpha.1) for an FMU: a reference experiment.

Any tool can run the experiment and compare the result. The data are files next to the subsystem, written by
`python -m fmus.machine.reference`: parameters and start values, inputs, result. They are valid for any
parameter values that the FMU is built with, because the experiment sets all parameters.
"""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import NamedTuple

from lxml import etree

from fmus.contract import Subsystem, quantities
from orchestrator.base.xml import shortest_decimal, xml_text
from orchestrator.fmi.description import FmuVariable
from orchestrator.ssp.common_elements import NAMESPACES
from orchestrator.ssp.write import parameter_set

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
PAGE = "documentation/fmi-ls-ref.html"
COMMUNICATION_STEP = 1e-2  # s
TOLERANCE = 1e-9  # relative, of the FMU's solver; 1000 times tighter than its default
# limit of the RMS deviation from the reference, relative to the range of a signal; the default tolerance of
# the solver gives hundreds of times more
NRMSE_LIMIT = 1e-5
_PARAMETER = f"{{{NAMESPACES['ssv']}}}Parameter"
_LS = "http://fmi-standard.org/fmi-ls-manifest"


class RelatedFile(NamedTuple):
    """How the manifest describes a file."""

    mime_type: str
    role: str
    description: str


_RELATED = {
    "parameters.ssv": RelatedFile(
        "application/x-ssp-parameter-set", "parameter", "Parameters and start values of the experiment"
    ),
    "experiment.exp": RelatedFile(
        "application/x-ma-hs-experiments", "experiment/validation", "Part of a work cycle"
    ),
    "input.csv": RelatedFile("text/csv", "other", f"Inputs, set every {1e3 * COMMUNICATION_STEP:g} ms"),
    "result.csv": RelatedFile("text/csv", "result", "Result, computed with CVODES from the equations"),
    f"../../{PAGE}": RelatedFile("text/html", "document", "Description of the experiment"),
}


def data_file(sub: Subsystem, name: str) -> Path:
    """Path of a data file of the experiment; the variants of a component share one input.csv."""
    variant = sub.name.removeprefix(sub.component).strip("_")
    prefix = f"reference_{variant}" if variant and name != "input.csv" else "reference"
    return sub.folder / f"{prefix}_{name}"


def ls_ref_files(sub: Subsystem) -> dict[str, bytes]:
    """The files by path in the FMU; none if there is no reference result or it has other variables."""
    data = {name: data_file(sub, name) for name in ("parameters.ssv", "input.csv", "result.csv")}
    files = {name: path.read_bytes() for name, path in data.items() if path.is_file()}
    groups = (sub.parameters, sub.inputs, sub.states, sub.outputs)
    declared = {name for group in groups for name in quantities(group)}
    if "result.csv" not in files or not _variables(files) <= declared:
        return {}
    lines = files["result.csv"].decode().strip().splitlines()
    stop = float(lines[-1].partition(",")[0])
    has_inputs = "input.csv" in files
    files["experiment.exp"] = _experiment(sub, stop, has_inputs)
    files["fmi-ls-manifest.xml"] = _manifest([n for n in _RELATED if n in files or n.startswith("..")])
    page = _page(sub, stop, lines[0].split(",")[1:], has_inputs)
    return {f"{FOLDER}/{name}": content for name, content in files.items()} | {PAGE: page.encode()}


def _variables(files: Mapping[str, bytes]) -> set[str]:
    """Names of the variables in the CSV files and in parameters.ssv."""
    tables = (content for name, content in files.items() if name.endswith(".csv"))
    columns = {name for t in tables for name in t.decode().partition("\n")[0].split(",")[1:]}
    return columns | {str(e.get("name")) for e in etree.fromstring(files["parameters.ssv"]).iter(_PARAMETER)}


def _manifest(names: list[str]) -> bytes:
    element = etree.Element("fmiReferences", nsmap={"fmi-ls": _LS})
    attributes = {
        "name": "org.fmi-standard.fmi-ls-ref",
        "version": "1.0.0-alpha.1",
        "description": "Layered Standard providing information on related files included in an FMU.",
    }
    for key, value in attributes.items():
        element.set(f"{{{_LS}}}fmi-ls-{key}", value)
    for name in names:
        file = _RELATED[name]
        attributes = {"type": file.mime_type, "source": name, "role": file.role}
        etree.SubElement(element, "Related", attributes | {"description": file.description})
    return xml_text(element)


def _experiment(sub: Subsystem, stop: float, has_inputs: bool) -> bytes:
    """experiment.exp, in the experiments format of the Modelica Association (draft of 2026)."""
    element = etree.Element("Experiments", name=sub.name, description=f"Reference experiment of {sub.name}")
    experiment = etree.SubElement(element, "Experiment", name="work_cycle", tolerance=f"{TOLERANCE:g}")
    experiment.set("description", _RELATED["experiment.exp"].description)
    times = {"startTime": 0.0, "stopTime": stop, "stepSize": COMMUNICATION_STEP}
    etree.SubElement(
        experiment, "TransientSimulation", {name: shortest_decimal(value) for name, value in times.items()}
    )
    etree.SubElement(experiment, "Parameters", source="parameters.ssv")
    if has_inputs:
        etree.SubElement(experiment, "Stimuli", source="input.csv")
    etree.SubElement(experiment, "References", source="result.csv")
    return xml_text(element)


def reference_parameters(sub: Subsystem, values: Mapping[str, float]) -> bytes:
    """parameters.ssv, in the units of the variables; equal values give equal bytes in all versions."""
    parameters = {name: (FmuVariable(name), value) for name, value in values.items()}
    return parameter_set(f"{sub.name} reference experiment", parameters)


def _page(sub: Subsystem, stop: float, signals: list[str], has_inputs: bool) -> str:
    names = ", ".join(f"<code>{escape(name)}</code>" for name in signals)
    folder = f"../{FOLDER}"
    inputs = (
        f'<p>The inputs in <a href="{folder}/input.csv">input.csv</a> are set at each communication point '
        "and held by the importer until the next one. Between these points the FMU extrapolates each input "
        "by means of the inputs that are its time derivatives. A tool that interpolates inputs by itself "
        "must not do so here.</p>"
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{escape(sub.name)}: reference experiment</title></head>
<body>
<h1>{escape(sub.name)}: reference experiment</h1>
<p>Co-simulation from 0 to {stop:g} s with a communication step of {COMMUNICATION_STEP:g} s, after all values
of <a href="{folder}/parameters.ssv">parameters.ssv</a> were set. An FMU that was built with other parameter
values contains the same experiment; once these values are set, it must reproduce the result.</p>
{inputs if has_inputs else "<p>There are no inputs.</p>"}
<p>The result in <a href="{folder}/result.csv">result.csv</a> was not computed with this FMU: CVODES solved
the symbolic equations of this subsystem alone, to a relative tolerance of 1e-11. A row contains the values
at the end of a step, before the next inputs are set. The root mean square deviation of each signal should be
below {NRMSE_LIMIT:g} of its range at the tolerance of {TOLERANCE:g} that the experiment specifies. The
deviation is the error of the FMU's solver and is proportional to the tolerance.</p>
<p>Signals: {names}.</p>
<p>The files conform to the layered standard FMI-LS-REF (draft 1.0.0-alpha.1);
<code>harvester check {escape(sub.name)}.fmu</code> runs the experiment.</p>
</body>
</html>
"""
