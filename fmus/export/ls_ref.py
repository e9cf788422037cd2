"""Files of the layered standard FMI-LS-REF (draft 1.0.0-alpha.1) for an FMU: a reference experiment.

Any tool can run the experiment and compare the result. The data are files next to the subsystem, written by
`python -m fmus.machine.reference`: parameters and start values, inputs, result. They are valid for any
parameter values that the FMU is built with, because the experiment sets all parameters.
"""

from collections.abc import Mapping
from pathlib import Path

from lxml import etree

from fmus.contract import Subsystem, quantities
from orchestrator.base.text import rendered
from orchestrator.base.xml import rendered_xml
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
TEMPLATES = Path(__file__).with_name("templates")


# how the manifest describes a file: MIME type, role, description
_RELATED = {
    "parameters.ssv": (
        "application/x-ssp-parameter-set",
        "parameter",
        "Parameters and start values of the experiment",
    ),
    "experiment.exp": ("application/x-ma-hs-experiments", "experiment/validation", "Part of a work cycle"),
    "input.csv": ("text/csv", "other", f"Inputs, set every {1e3 * COMMUNICATION_STEP:g} ms"),
    "result.csv": ("text/csv", "result", "Result, computed with CVODES from the equations"),
    f"../../{PAGE}": ("text/html", "document", "Description of the experiment"),
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
    content = {
        "name": sub.name,
        "stop": stop,
        "step": COMMUNICATION_STEP,
        "tolerance": TOLERANCE,
        "limit": NRMSE_LIMIT,
        "folder": f"../{FOLDER}",
        "description": _RELATED["experiment.exp"][2],
        "signals": lines[0].split(",")[1:],
        "has_inputs": "input.csv" in files,
    }
    # in the experiments format of the Modelica Association (draft of 2026)
    files["experiment.exp"] = rendered_xml(TEMPLATES / "experiment.exp.j2", **content)
    related = {name: file for name, file in _RELATED.items() if name in files or name.startswith("..")}
    files["fmi-ls-manifest.xml"] = rendered_xml(TEMPLATES / "fmi-ls-manifest.xml.j2", related=related)
    page = rendered(TEMPLATES / "fmi-ls-ref.html.j2", escaped=True, **content)
    return {f"{FOLDER}/{name}": content for name, content in files.items()} | {PAGE: page.encode()}


def _variables(files: Mapping[str, bytes]) -> set[str]:
    """Names of the variables in the CSV files and in parameters.ssv."""
    tables = (content for name, content in files.items() if name.endswith(".csv"))
    columns = {name for t in tables for name in t.decode().partition("\n")[0].split(",")[1:]}
    return columns | {str(e.get("name")) for e in etree.fromstring(files["parameters.ssv"]).iter(_PARAMETER)}


def reference_parameters(sub: Subsystem, values: Mapping[str, float]) -> bytes:
    """parameters.ssv, in the units of the variables; equal values give equal bytes in all versions."""
    parameters = {name: (FmuVariable(name), value) for name, value in values.items()}
    return parameter_set(f"{sub.name} reference experiment", parameters)
