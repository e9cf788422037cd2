"""Writes valve_map.csv, in place of a test bench: steady flows of a valve with two equal metering edges.

    extending    Q^2 = K^2 (P_s - P_head)       (r Q)^2 = K^2 (P_rod - P_t)       P_load = P_head - r P_rod
    retracting   (r Q)^2 = K^2 (P_s - P_rod)    Q^2 = K^2 (P_head - P_t)

so Q = K sqrt((P_s - P_load) / (1 + r^3)) and Q = -K sqrt((P_load + r P_s) / (1 + r^3)) for P_t = 0; a load
that is too much drives the flow back. Hoses count with their resistance: 1/K^2 = 1/K_valve^2 + C_R.
"""

from pathlib import Path

import numpy as np

SUPPLY, RATIO, HOSE = 20.684e6, 0.65, 2.8e10  # Pa, rod side over head side, Pa.s2/m6
FULL = 0.62 * 4e-5 * np.sqrt(2 / 970)  # K of the open valve [m3/s/Pa^(1/2)]
COMMANDS = np.array([-10, -8, -6, -5, -4, -3, -2, -1, -0.6, 0.6, 1, 2, 3, 4, 5, 6, 8, 10])  # V
LOADS = np.arange(-30e6, 30.1e6, 2e6)  # Pa


def flow(command: float, load: np.ndarray) -> np.ndarray:
    """Flow into the head side [m3/s]."""
    opened = FULL * max(abs(command) - 0.6, 0.0) / 9.4
    drive = SUPPLY - load if command > 0 else load + RATIO * SUPPLY
    gain = opened / np.sqrt(1 + HOSE * opened**2)
    return np.sign(command) * gain * np.sign(drive) * np.sqrt(np.abs(drive) / (1 + RATIO**3))


if __name__ == "__main__":
    rows = np.column_stack([COMMANDS, [flow(c, LOADS) for c in COMMANDS]])
    head = "flow into the head side [m3/s] over command [V] (first column) and load pressure [Pa] (first row)"
    table = np.vstack([[0.0, *LOADS], rows])
    np.savetxt(Path(__file__).with_name("valve_map.csv"), table, "%.6g", ",", header=head)
