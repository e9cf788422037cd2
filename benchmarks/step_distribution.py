"""What adaptive steps can save at most on the work cycle: `python -m benchmarks.step_distribution`.

The error of an input over a step of a method of order 4 is in proportion to y4 h^4, where y4 is the fourth
derivative of its source. If every step acts for the same time on what follows, the mean square error of a run
with steps h(t) is in proportion to the mean of g h^8, where g(t) = y4^2, and the number of steps to the mean
of 1 / h. For a given error this number is least for h in proportion to g^(-1/9). Over the number of equal
steps with the same error it is

    mean(g^(1/9))^(9/8) / mean(g)^(1/8)

g is the square of the fourth difference of the source over points 5 ms and 10 ms apart, along an accurate
solution. The first table has the sources of all inputs between the drives and the manipulator. By the reverse
Minkowski inequality no sum of several g has a smaller ratio than the smallest of its terms. In the second
table g is the mean square of the true error of a joint speed in windows, with equal steps of 10 ms.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.calibration import SPEEDS, TRUTH
from fmus.machine.build import data, harvester
from orchestrator import load, run

ORDER = 4
SAMPLING = 2.5e-3  # s
SPACINGS = (2, 4)  # samples between the points of a fourth difference
WINDOWS = (1.0, 0.5, 0.2, 0.1)  # s
STEP = 1e-2  # s
WORK_CYCLE = data("scenarios/work_cycle.csv")


def least_steps(g: NDArray[np.float64]) -> float:
    """The least number of steps over that of equal steps with the same error; g: shape (n,)."""
    power = 2 * ORDER
    most = np.mean(g ** (1 / (power + 1))) ** ((power + 1) / power)
    return float(most / np.mean(g) ** (1 / power))


def fourth_difference(y: NDArray[np.float64], k: int) -> NDArray[np.float64]:
    """The fourth difference over points k samples apart."""
    ends = len(y) - 4 * k
    return np.asarray(sum(c * y[i * k : i * k + ends] for i, c in enumerate((1, -4, 6, -4, 1))))


def main() -> None:
    """Print both tables."""
    with tempfile.TemporaryDirectory() as name:
        harvester().write(Path(name))
        system = load(Path(name) / "harvester.ssp")
        parts = {"swing", "boom_stick", "manipulator"}
        sources = sorted(
            {
                str(c.source)
                for c in system.connections
                if {c.source.component, c.target.component} <= parts
                and not c.source.variable.endswith("_rate")
            }
        )
        fine = {"record_step": SAMPLING, "tolerance": 1e-11, "isolate": False}
        true = run(system, WORK_CYCLE, master=TRUTH, step=2.5e-4, record=[*sources, *SPEEDS], **fine).trace
        equal = run(
            system, WORK_CYCLE, master="hermite", step=STEP, record=SPEEDS, tolerance=1e-9, isolate=False
        ).trace
    print("least number of steps over that of equal steps, same error")
    print(f"{'source of an input':<36}" + "".join(f"{k * SAMPLING * 1e3:>8g} ms" for k in SPACINGS))
    for source in sources:
        if np.ptp(true[source]):
            ratios = (least_steps(fourth_difference(true[source], k) ** 2) for k in SPACINGS)
            print(f"{source:<36}" + "".join(f"{ratio:>11.2f}" for ratio in ratios))
    print(f"\n{'error in windows of':<36}" + "".join(f"{w:>9g} s" for w in WINDOWS))
    every = round(STEP / SAMPLING)
    for speed in SPEEDS:
        squares = np.square(equal[speed] - true[speed][::every])
        row = []
        for window in WINDOWS:
            n = round(window / STEP)
            row.append(least_steps(squares[: len(squares) // n * n].reshape(-1, n).mean(axis=1)))
        print(f"{speed:<36}" + "".join(f"{ratio:>11.2f}" for ratio in row))


if __name__ == "__main__":
    main()
