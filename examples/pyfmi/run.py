"""The machine in PyFMI, after `harvester build`: `python examples/pyfmi/run.py [--step 5e-3] [--no-rates]`.

PyFMI's master steps the four FMUs of harvester.ssp side by side and holds their inputs; the connections are
those of the file. Printed is how near the work cycle comes to the reference.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

sys.path.append(str(Path(__file__).parents[1] / "work_cycle"))
from accuracy import SIGNALS, SYSTEM, report

NAMESPACE = {"ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription"}
Wire = tuple[str, str, str, str]  # element and connector at the start and at the end


def unpack(system: Path, folder: Path) -> tuple[dict[str, Path], list[Wire]]:
    """The FMUs of an SSP by component, and its connections."""
    with zipfile.ZipFile(system) as archive:
        archive.extractall(folder)
    root = ElementTree.parse(folder / "SystemStructure.ssd").getroot()
    parts = {
        c.attrib["name"]: folder / c.attrib["source"] for c in root.iterfind(".//ssd:Component", NAMESPACE)
    }
    ends = ("startElement", "startConnector", "endElement", "endConnector")
    wires = [c for c in root.iterfind(".//ssd:Connection", NAMESPACE)]
    return parts, [tuple(wire.attrib[end] for end in ends) for wire in wires]


def simulate(system: Path, step: float, stop: float, rates: bool) -> str:
    """Run and report."""
    from pyfmi import load_fmu
    from pyfmi.master import Master

    with tempfile.TemporaryDirectory() as name:
        paths, wires = unpack(system, Path(name))
        parts = {
            part: load_fmu(str(path), kind="CS", log_file_name=str(path.with_suffix(".txt")))
            for part, path in paths.items()
        }
        if not rates:
            wires = [wire for wire in wires if not wire[3].endswith(("_rate", "_acceleration"))]
        master = Master(list(parts.values()), [(parts[a], x, parts[b], y) for a, x, b, y in wires])
        options = master.simulate_options()
        options["step_size"] = step
        options["block_initialization"] = True  # without, PyFMI 3.0 asks for a square Jacobian and stops
        options["result_handling"] = "memory"
        result = master.simulate(final_time=stop, options=options)
    of = {name: result[parts[name.split(".")[0]]] for name in SIGNALS}
    found = {name: values[name.split(".")[1]] for name, values in of.items()}
    return report(next(iter(of.values()))["time"], found)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="The machine in PyFMI")
    parser.add_argument("system", nargs="?", type=Path, default=SYSTEM)
    parser.add_argument("--step", type=float, default=1e-3, help="communication step [s]")
    parser.add_argument("--stop", type=float, default=42.0, help="[s]")
    parser.add_argument("--no-rates", action="store_true", help="leave the rate ports open")
    chosen = parser.parse_args()
    try:
        print(simulate(chosen.system, chosen.step, chosen.stop, not chosen.no_rates))
    except ModuleNotFoundError as missing:
        sys.exit(f"PyFMI is not here ({missing}): conda install -c conda-forge pyfmi")
    except FileNotFoundError as missing:
        sys.exit(f"{missing.filename} is not there: run `harvester build` first")


if __name__ == "__main__":
    main()
