"""The reference experiment that an FMU carries by FMI-LS-REF (draft 1.0.0-alpha.1), for any tool.

Its data lie beside the subsystem and are made by `python -m fmus.machine.reference`: parameters and start
values, inputs, result. They stay together whatever numbers the FMU is built with; the experiment sets all of
them.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path

from lxml import etree

from fmus.contract import Subsystem, quantities
from orchestrator.base.xml import shortest_decimal
from orchestrator.fmi.description import FmuVariable
from orchestrator.ssp.write import parameter_set
from orchestrator.ssp.xml_writing import NAMESPACES, xml_text

PLACE = "extra/org.fmi-standard.fmi-ls-ref"
PAGE = "documentation/fmi-ls-ref.html"
STEP = 1e-2  # s, at which the inputs are set
TOLERANCE = 1e-9  # of the FMU's solver, tighter than its default: what is left is hardly its error
BOUND = 1e-5  # largest deviation, over range; hundreds of times more at the default tolerance
_PARAMETER = f"{{{NAMESPACES['ssv']}}}Parameter"
_LS = "http://fmi-standard.org/fmi-ls-manifest"
# file -> MIME type, role, text
_RELATED = {
    "parameters.ssv": (
        *("application/x-ssp-parameter-set", "parameter"),
        "Parameters and start values of the reference experiment",
    ),
    "experiment.exp": (
        *("application/x-ma-hs-experiments", "experiment/validation"),
        "Part of a work cycle, inputs set every 10 ms",
    ),
    "input.csv": ("text/csv", "other", "Inputs of the reference experiment"),
    "result.csv": ("text/csv", "result", "Result of the reference experiment, by CVODES on the equations"),
    "../../documentation/fmi-ls-ref.html": ("text/html", "document", "How the experiment is meant"),
}


def data_file(sub: Subsystem, name: str) -> Path:
    """Where a file of the experiment is kept; all variants of a part get the same inputs."""
    own = sub.name.removeprefix(sub.component).strip("_")
    which = f"reference_{own}" if own and name != "input.csv" else "reference"
    return sub.folder / f"{which}_{name}"


def ls_ref_files(sub: Subsystem) -> dict[str, bytes]:
    """Path in the FMU -> content; nothing for a subsystem without reference, or with other variables."""
    data = {name: data_file(sub, name) for name in ("parameters.ssv", "input.csv", "result.csv")}
    files = {name: path.read_bytes() for name, path in data.items() if path.is_file()}
    if "result.csv" not in files or not _named(files) <= _variables(sub):
        return {}
    lines = files["result.csv"].decode().strip().splitlines()
    stop = float(lines[-1].partition(",")[0])
    files["experiment.exp"] = _experiment(sub, stop, "input.csv" in files)
    files["fmi-ls-manifest.xml"] = _manifest([n for n in _RELATED if n in files or n.startswith("..")])
    page = _page(sub, stop, lines[0].split(",")[1:], "input.csv" in files)
    return {f"{PLACE}/{name}": content for name, content in files.items()} | {PAGE: page.encode()}


def _named(files: Mapping[str, bytes]) -> set[str]:
    """Variables that the files name."""
    tables = (content for name, content in files.items() if name.endswith(".csv"))
    columns = {name for t in tables for name in t.decode().partition("\n")[0].split(",")[1:]}
    return columns | {str(e.get("name")) for e in etree.fromstring(files["parameters.ssv"]).iter(_PARAMETER)}


def _variables(sub: Subsystem) -> set[str]:
    groups = (sub.parameters, sub.inputs, sub.states, sub.outputs)
    return {name for group in groups for name in quantities(group)}


def _manifest(names: list[str]) -> bytes:
    about = "Layered Standard providing information on related files included in an FMU."
    element = etree.Element("fmiReferences", nsmap={"fmi-ls": _LS})
    for key, value in (
        ("name", "org.fmi-standard.fmi-ls-ref"),
        ("version", "1.0.0-alpha.1"),
        ("description", about),
    ):
        element.set(f"{{{_LS}}}fmi-ls-{key}", value)
    for name in names:
        kind, role, words = _RELATED[name]
        etree.SubElement(element, "Related", type=kind, source=name, role=role, description=words)
    return xml_text(element)


def _experiment(sub: Subsystem, stop: float, stimuli: bool) -> bytes:
    """Experiments format of the Modelica Association, draft of 2026."""
    element = etree.Element("Experiments", name=sub.name, description=f"Reference experiment of {sub.name}")
    one = etree.SubElement(element, "Experiment", name="work_cycle", tolerance=f"{TOLERANCE:g}")
    one.set("description", _RELATED["experiment.exp"][2])
    times = {"startTime": 0.0, "stopTime": stop, "stepSize": STEP}
    etree.SubElement(
        one, "TransientSimulation", {name: shortest_decimal(value) for name, value in times.items()}
    )
    etree.SubElement(one, "Parameters", source="parameters.ssv")
    if stimuli:
        etree.SubElement(one, "Stimuli", source="input.csv")
    etree.SubElement(one, "References", source="result.csv")
    return xml_text(element)


def reference_parameters(sub: Subsystem, values: Mapping[str, float]) -> bytes:
    """The SSV file, in the units of the variables; another version with the same numbers is the same file."""
    known = {name: (FmuVariable(name), value) for name, value in values.items()}
    return parameter_set(f"{sub.name} reference experiment", known)


def _page(sub: Subsystem, stop: float, signals: list[str], stimuli: bool) -> str:
    names = ", ".join(f"<code>{escape(name)}</code>" for name in signals)
    where = f"../{PLACE}"
    inputs = (
        f'<p>The inputs in <a href="{where}/input.csv">input.csv</a> are set at each communication point '
        "and left alone until the next one. In between the FMU moves each of them along with the inputs that "
        "carry its time derivatives. A tool that interpolates inputs by itself must not do so here.</p>"
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{escape(sub.name)}: reference experiment</title></head>
<body>
<h1>{escape(sub.name)}: reference experiment</h1>
<p>Co-simulation from 0 to {stop:g} s with a communication step of {STEP:g} s, after all values of
<a href="{where}/parameters.ssv">parameters.ssv</a> were set. An FMU that was built with other numbers carries
the same experiment, and meets it with these.</p>
{inputs if stimuli else "<p>There are no inputs.</p>"}
<p>The result in <a href="{where}/result.csv">result.csv</a> was not made with this FMU: CVODES solved the
equations of this subsystem alone, to a relative tolerance of 1e-11, from symbolic expressions. A row holds
the values at the end of a step, before the next inputs are set. Expected is a root mean square deviation
below {BOUND:g} of the range of each signal at the tolerance of {TOLERANCE:g} that the experiment asks for; it
grows in proportion to the tolerance.</p>
<p>Signals: {names}.</p>
<p>The files are described by the layered standard FMI-LS-REF (draft 1.0.0-alpha.1);
<code>harvester check {escape(sub.name)}.fmu</code> runs the experiment.</p>
</body>
</html>
"""
