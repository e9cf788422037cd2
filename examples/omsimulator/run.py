"""The machine in OMSimulator, after `harvester build`: `python examples/omsimulator/run.py [--step 5e-3]`.

OMSimulator 3 opens harvester.ssp as it is. Printed is how near the work cycle comes to the reference.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "work_cycle"))
from accuracy import SIGNALS, SYSTEM, report


def simulate(system: Path, step: float, stop: float) -> str:
    """Run and report."""
    from OMSimulator import SSP

    if not system.is_file():
        raise FileNotFoundError(2, "", str(system))
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "result.csv"
        model = SSP(str(system)).instantiate()
        model.setResultFile(str(target))
        model.removeSignalsFromResults(".*")
        model.addSignalsToResults("|".join(re.escape(f"harvester.{name}") for name in SIGNALS))
        model.setFixedStepSize(step)
        model.setLoggingInterval(0.0)  # every step
        model.setStopTime(stop)
        model.initialize()
        model.simulate()
        model.terminate()
        model.delete()
        return report(*read(target))


def read(file: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time and signals; of several rows at one time the last."""
    with file.open(encoding="utf-8") as lines:
        names = lines.readline().strip().replace('"', "").split(",")
        rows = np.loadtxt(lines, delimiter=",")
    rows = rows[np.append(np.diff(rows[:, 0]) > 0, True)]
    columns = dict(zip(names, rows.T, strict=True))
    return columns["time"], {name: columns[f"harvester.{name}"] for name in SIGNALS}


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="The machine in OMSimulator")
    parser.add_argument("system", nargs="?", type=Path, default=SYSTEM)
    parser.add_argument("--step", type=float, default=1e-3, help="communication step [s]")
    parser.add_argument("--stop", type=float, default=42.0, help="[s]")
    chosen = parser.parse_args()
    try:
        print(simulate(chosen.system, chosen.step, chosen.stop))
    except ModuleNotFoundError as missing:
        sys.exit(f"OMSimulator is not here ({missing}): pip install OMSimulator; OpenModelica brings it too")
    except FileNotFoundError as missing:
        sys.exit(f"{missing.filename} is not there: run `harvester build` first")


if __name__ == "__main__":
    main()
