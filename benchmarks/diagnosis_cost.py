"""Cost of a step of the diagnosis beside those of the parts: `python -m benchmarks.diagnosis_cost`.

The parts alone run with constant inputs, best of ten, in turn. What a run costs without a step, and the loop
over steps, is in each figure.
"""

from time import perf_counter

from orchestrator import run

FOLDER, STOP, STEP = "build/faults", 40.0, 1e-3
PARTS = {
    "diagnosis": "payload",
    "boom_stick": "boom_head_pressure",
    "swing": "swing_pressure_a",
    "sensors": "boom_angle_measured",
}


def once(name: str, signal: str) -> float:
    """Time per step [us]."""
    begin = perf_counter()
    run(f"{FOLDER}/{name}.fmu", stop=STOP, step=STEP, record=signal, record_step=1.0)
    return 1e6 * (perf_counter() - begin) * STEP / STOP


def main() -> None:
    """Print each part, less what a run costs without a step."""
    best = dict.fromkeys(PARTS, 1e9)
    for _ in range(10):
        for name, signal in PARTS.items():
            best[name] = min(best[name], once(name, signal))
    for name, time in best.items():
        print(f"{name:12} {time:6.2f} us per step of 1 ms")


if __name__ == "__main__":
    main()
