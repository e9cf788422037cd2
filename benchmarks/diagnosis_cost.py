"""Cost of a step of the diagnosis beside those of the parts: `python -m benchmarks.diagnosis_cost`.

The parts alone run with constant inputs. The cost is the difference of a long run and a short one over that
of their steps, so loading an FMU is not in it; the loop over steps is. Best of ten of both, in turn.
"""

from itertools import product
from time import perf_counter

from orchestrator import run

FOLDER, STEP = "build/faults", 1e-3
SHORT, LONG = 1.0, 61.0  # s
PARTS = {
    "diagnosis": "payload",
    "boom_stick": "boom_head_pressure",
    "swing": "swing_pressure_a",
    "manipulator": "boom_angle",
    "sensors": "boom_angle_measured",
}


def once(name: str, stop: float) -> float:
    """Wall time of a run [s]."""
    begin = perf_counter()
    run(f"{FOLDER}/{name}.fmu", stop=stop, step=STEP, record=PARTS[name], record_step=1.0)
    return perf_counter() - begin


def main() -> None:
    """Print each part."""
    cases = list(product(PARTS, (SHORT, LONG)))
    best = dict.fromkeys(cases, 1e9)
    for _ in range(10):
        for name, stop in cases:
            best[name, stop] = min(best[name, stop], once(name, stop))
    for name in PARTS:
        time = 1e6 * (best[name, LONG] - best[name, SHORT]) * STEP / (LONG - SHORT)
        print(f"{name:12} {time:6.2f} us per step of 1 ms")


if __name__ == "__main__":
    main()
