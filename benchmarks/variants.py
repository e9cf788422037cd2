"""What each variant costs without Python around it, also by `make bench`.

The inputs that each part gets during the work cycle of the usual machine are played into every variant of the
part by a C program, compiled together with the sources in the FMU. Machines differ and are noisy: compare
figures of one sitting only.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import fmpy
import numpy as np

from fmus.contract import quantities
from fmus.export.compile import HEADERS
from fmus.machine.build import harvester
from fmus.machine.parts import FAMILIES
from orchestrator import Trace, run
from orchestrator.base.files import VARIANTS

STEP = 1e-3  # s


def nanoseconds(fmu: Path, part: str, inputs: list[str], trace: Trace) -> float:
    """Time of one step, the inputs set before it."""
    variables = {v.name: v for v in fmpy.read_model_description(str(fmu)).modelVariables}
    names = [n for n in inputs if f"{part}.{n}" in trace.signals]
    rows = np.column_stack([trace[f"{part}.{n}"] for n in names])
    references = np.array([variables[n].valueReference for n in names], dtype=np.uint32)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        zipfile.ZipFile(fmu).extractall(place)
        data = place / "inputs.bin"
        data.write_bytes(
            np.array(rows.shape[::-1], np.int32).tobytes() + references.tobytes() + rows.tobytes()
        )
        (source,) = (place / "sources").glob("*_fmu.c")
        program = place / "replay"
        command = [sys.executable, "-m", "ziglang", "cc", "-O3", "-std=c99", "-D_POSIX_C_SOURCE=200809L"]
        command += [f"-I{HEADERS}", f"-I{source.parent}", str(Path(__file__).with_name("replay.c"))]
        subprocess.run([*command, str(source), "-lm", "-o", str(program)], check=True)
        told = subprocess.run([str(program), str(data)], check=True, capture_output=True, text=True).stdout
    return float(told)


def main() -> None:
    """Print the table."""
    print(f"{'':<30}{'ns per 1 ms':>12}{'to the usual':>14}")
    with tempfile.TemporaryDirectory() as folder:
        harvester().write(Path(folder))
        trace = run(Path(folder) / "harvester.ssp", step=STEP).trace
        for part, variants in FAMILIES.items():
            usual = 0.0
            for variant, sub in variants.items():
                fmu = Path(folder) / VARIANTS / f"{part}_{variant}.fmu"
                spent = nanoseconds(fmu, part, list(quantities(sub.inputs)), trace)
                usual = usual or spent
                ratio = f"{spent / usual:.2f}" if quantities(sub.states) and usual > 50 else ""
                print(f"{part + ' ' + variant:<30}{spent:>12.0f}{ratio:>14}")


if __name__ == "__main__":
    main()
