"""`--accuracy` on systems that are no harvesters: is any result wrong without a word?

    python -m benchmarks.not_harvesters [--kinds rich plain poor] [--only WORD] [--processes 2]

Each system of SYSTEMS is run with FMUs of four kinds and three accuracies:

    told    states, directional derivatives, saved state, derivatives of inputs and of outputs
    rich    the same without those of outputs
    plain   saved state only
    poor    nothing

and compared with its truth, which not_harvesters.c computes as one system. A cell of the table is

    met        with estimate over true error
    refused    exit status 2 of `harvester run`
    unknown    the card says that the accuracy is not known
    missed     the error is above the accuracy, by less than WRONG
    SILENT     it is more above it, with the error and its estimate

Exit status 1: a result is silent, or could not be made. Without options the counts go into docs/coupling.md.
"""

from __future__ import annotations

import re
import sys
import tempfile
import time
from argparse import ArgumentParser
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from ctypes import CDLL, POINTER, c_double
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from kit.any_fmu.description import Description, V, member, packed
from kit.compile import SHARED, compiled

from orchestrator import Problem, RunFailed, System, assemble, run

SOURCE = Path(__file__).with_suffix(".c")
PAGE, MARKS = (
    Path(__file__).parents[1] / "docs" / "coupling.md",
    ("<!-- not harvesters -->\n", "<!-- end -->"),
)
KINDS = "told", "rich", "plain", "poor"
OUTCOMES = "met", "missed", "refused", "unknown", "SILENT"
ACCURACIES = 1e-2, 1e-3, 1e-4
WRONG = 3.0  # error over the accuracy from which a result is silently wrong
TRUTH_STEP = 1e-5  # s
TOLD = re.compile(r"estimated RMS error (\S+) of the range")
TIME_LIMIT = 120.0  # s of wall time
ABLE = {
    "told": {"providesDirectionalDerivative": "true", "maxOutputDerivativeOrder": 1},
    "rich": {"providesDirectionalDerivative": "true"},
}
SAVED = {"canGetAndSetFMUstate": "true"}
# model -> inputs, outputs with the inputs and states on which each depends, number of states
MODELS: Mapping[str, tuple[int, Sequence[str], int]] = {
    "spring_mass": (1, ("u0 x0", "x0", "x1"), 2), "mass": (1, ("x0", "x1"), 2),
    "cell": (2, ("x0", "u0 x0"), 1), "wave": (0, ("",), 0), "pulse": (0, ("",), 0), "pwm": (0, ("",), 0),
    "chopper": (1, ("u0",), 0), "coil": (1, ("x0",), 1), "lag": (2, ("x0",), 1),
    "rectifier": (1, ("x0",), 1), "controller": (1, ("",), 0), "pendulum": (1, ("x0",), 2),
    "delay": (1, ("",), 0), "relay": (1, ("",), 0), "actuator": (1, ("x0",), 1),
    "motor": (2, ("x2", "x1", "x0"), 3), "gear": (2, ("u0 x0", "x0", "x1"), 2),
    "heater": (1, ("x0 u0", "x0"), 1), "room": (1, ("x0",), 1), "sum": (2, ("u0 u1",), 0),
    "cubic": (2, ("u0 u1",), 0),
    "slider": (1, ("x0", "x1"), 2), "belt": (1, ("u0",), 0), "ball": (1, ("x0", "x1"), 2),
    "floor": (2, ("u0 u1",), 0), "lorenz_x": (1, ("x0",), 1), "lorenz_yz": (1, ("x0", "x1"), 2),
    "pulser": (1, ("u0",), 1), "regulator": (1, ("u0 x0",), 1),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A system; what each component has: model, parameters; start: of states, by component.

    truth    index in not_harvesters.c, start values there, and the state that is `watched`
    steps    component -> suggested step [s], or None; 1 ms without an entry
    """

    components: Mapping[str, tuple[object, ...]]
    wires: Sequence[str]
    watched: str
    truth: tuple[int, int]
    start: Sequence[float] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    stop: float = 4.0
    steps: Mapping[str, float | None] = field(default_factory=dict)
    discrete: str = ""


def _oscillators(k: int, ratio: float) -> Case:
    return Case(
        {"a": ("spring_mass", 1, 10, 100), "b": ("mass", ratio, 50)},
        ("a.y0 -> b.u0", "b.y0 -> a.u0"), "a.y1", (k, 0), (1.0,), {"a.x0": 1.0},
    )  # fmt: skip


def _sampled(k: int, discrete: str) -> Case:
    return Case(
        {"c": ("controller", 1.5, 3, 0.025, 0.5), "p": ("pendulum", 4, 9, 2)},
        ("c.y0 -> p.u0", "p.y0 -> c.u0"), "p.y0", (k, 0), discrete=discrete,
    )  # fmt: skip


def _fed(source: tuple[object, ...], k: int, to: str = "coil", **more: object) -> Case:
    """A source into a coil or a rectifier."""
    return Case({"s": source, "c": (to, 2, 0.05)}, ("s.y0 -> c.u0",), "c.y0", (k, 0), **more)  # type: ignore[arg-type]


PWM = ("pwm", 24, 0.005, 0.3)
SYSTEMS: Mapping[str, Case] = {
    "oscillators, mass ratio 1e3": _oscillators(0, 1000.0),
    "oscillators, mass ratio 1e-3": _oscillators(1, 0.001),
    "oscillators, mass ratio 1": _oscillators(2, 1.0),
    "stiff RC chain": Case(
        {"w": ("wave", 5, 2), "a": ("cell", 1, 0.01), "b": ("cell", 2, 2e-4), "c": ("cell", 1, 0.05)},
        ("w.y0 -> a.u0", "a.y0 -> b.u0", "b.y1 -> a.u1", "b.y0 -> c.u0", "c.y1 -> b.u1"), "c.y0", (3, 2),
    ),
    "sampled PI, continuous": _sampled(4, ""),
    "sampled PI, discrete": _sampled(5, "c"),
    "dead time 50 ms": Case(
        {"w": ("wave", 0, 0, 0, 1), "p": ("lag", 2, 0.2), "d": ("delay", 0.05)},
        ("w.y0 -> p.u0", "d.y0 -> p.u1", "p.y0 -> d.u0"), "p.y0", (6, 0),
    ),
    "relay with hysteresis": Case(
        {"r": ("relay", 1, 0.8), "p": ("lag", 3, 0.5)}, ("r.y0 -> p.u0", "p.y0 -> r.u0"), "p.y0", (7, 0)
    ),
    "saturated actuator": Case(
        {"a": ("actuator", 20, 2, 0.05, 1), "p": ("lag", 1, 0.3)},
        ("a.y0 -> p.u0", "p.y0 -> a.u0"), "p.y0", (8, 0),
    ),
    "DC motor with backlash": Case(
        {"w": ("wave", 12, 0.7), "m": ("motor", 1, 0.01, 0.1, 0.02), "g": ("gear", 0.05, 40, 0.03, 0.05)},
        ("w.y0 -> m.u1", "g.y0 -> m.u0", "m.y0 -> g.u0", "m.y1 -> g.u1"), "g.y2", (9, 4),
    ),
    "thermal, fast and slow": Case(
        {"h": ("heater", 60, 4, 2, 35, 40), "r": ("room", 0.4, 50, 15)},
        ("h.y0 -> r.u0", "r.y0 -> h.u0"), "h.y1", (10, 0), (20.0, 20.0), {"h.x0": 20.0, "r.x0": 20.0}, 12.0,
    ),
    "algebraic loop, linear": Case(
        {"w": ("wave", 1, 1.5), "a": ("sum", 0.5, 1), "b": ("sum", -0.8, 0.3), "z": ("lag", 1, 0.1)},
        ("b.y0 -> a.u0", "w.y0 -> a.u1", "a.y0 -> b.u0", "z.y0 -> b.u1", "a.y0 -> z.u0"), "z.y0", (11, 0),
    ),
    "algebraic loop, cubic": Case(
        {"w": ("wave", 1, 1.5), "a": ("sum", 1, 1), "b": ("cubic", -0.5, 0.3), "z": ("lag", 0.3, 0.1)},
        ("b.y0 -> a.u0", "w.y0 -> a.u1", "a.y0 -> b.u0", "z.y0 -> b.u1", "a.y0 -> z.u0"), "z.y0", (12, 0),
    ),
    "stick-slip": Case(
        {"m": ("slider", 1, 8, 0.5, 0.02), "k": ("belt", 60)},
        ("k.y0 -> m.u0", "m.y0 -> k.u0"), "m.y0", (13, 0),
    ),
    "ball on a stiff floor": Case(
        {"b": ("ball", 1), "f": ("floor", 2e5, 40)},
        ("f.y0 -> b.u0", "b.y0 -> f.u0", "b.y1 -> f.u1"), "b.y0", (14, 0), (0.5,), {"b.x0": 0.5}, 2.0,
    ),
    "pulse of 0.8 ms": _fed(("pulse", 10, 3.1415, 0.0008), 15),
    "500 Hz, rectifier": _fed(("wave", 10, 500, 0.3), 16, "rectifier", stop=2.0),
    "Lorenz, 6 s": Case(
        {"x": ("lorenz_x",), "r": ("lorenz_yz",)},
        ("x.y0 -> r.u0", "r.y0 -> x.u0"), "x.y0", (17, 0), (1.0, 1.0, 20.0),
        {"x.x0": 1.0, "r.x0": 1.0, "r.x1": 20.0}, 6.0,
    ),
    "60 Hz, rectifier": _fed(("wave", 10, 60, 0.3), 18, "rectifier", stop=2.0),
    "PWM 200 Hz, 30 %": _fed(PWM, 19, stop=1.0),
    # more sources
    "PWM 162 Hz, 20 %": _fed(("pwm", 24, 0.00618, 124 / 618), 20, stop=1.0),
    "pulse of 0.3 ms": _fed(("pulse", 10, 1.7, 0.0003), 21),
    "PWM of an input": Case(
        {
            "w": ("wave", 0, 0, 0, 24), "p": ("lag", 1, 0.3),
            "s": ("chopper", 0, 0.005, 0.3), "c": ("coil", 2, 0.05),
        },
        ("w.y0 -> p.u0", "p.y0 -> s.u0", "s.y0 -> c.u0"), "c.y0", (22, 0), stop=1.0,
    ),
    "50 Hz and a pulse": Case(
        {"w": ("wave", 5, 50), "p": ("pulse", 20, 0.9, 0.0008), "s": ("sum", 1, 1), "c": ("coil", 2, 0.05)},
        ("w.y0 -> s.u0", "p.y0 -> s.u1", "s.y0 -> c.u0"), "c.y0", (23, 0), stop=2.0,
    ),
    "PWM, step 10 ms": _fed(PWM, 24, stop=1.0, steps={"s": 0.01, "c": 0.01}),
    "PWM, no step": _fed(PWM, 25, stop=1.0, steps={"s": None, "c": None}),
    "PWM, discrete": _fed(PWM, 26, stop=1.0, discrete="s"),
    "333 Hz, rectifier": _fed(("wave", 10, 1000 / 3, 1), 27, "rectifier", stop=2.0),
    "PWM 100 Hz, 2 %": _fed(("pwm", 24, 0.01, 0.02), 28, stop=1.0),
}  # fmt: skip


def library() -> Path:
    """All models and truths."""
    return compiled("not_harvesters.so", [SOURCE], *SHARED, "-O2", "-std=c11")


def truth(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and the watched state at them."""
    k, watched = case.truth
    rows = round(case.stop / TRUTH_STEP) + 1
    x, out = (c_double * 16)(*case.start), np.zeros(rows)
    solved = out.ctypes.data_as(POINTER(c_double))
    CDLL(str(library())).solve(k, x, watched, c_double(TRUTH_STEP), rows, solved)
    return TRUTH_STEP * np.arange(rows), out


def fmu(folder: Path, kind: str, model: str, step: float | None, discrete: bool) -> Path:
    """An FMU of a model."""
    inputs, outputs, states = MODELS[model]
    variables = [V(f"u{i}", "input", start=0.0, place=i) for i in range(inputs)]
    linear = kind in ABLE and states
    for i, depends in enumerate(outputs):
        known = [d for d in depends.split() if linear or d[0] == "u"]
        steady = "discrete" if discrete and i == 0 else None
        variables.append(V(f"y{i}", "output", depends=known, place=2 + i, steady=steady))
    of = [*(f"u{i}" for i in range(inputs)), *(f"x{i}" for i in range(states))]
    for i in range(states):
        variables.append(V(f"x{i}", "local", start=0.0, exact=True, place=5 + i))
        if linear:
            variables.append(V(f"dx{i}", "local", depends=of, derives=f"x{i}", place=8 + i))
    variables += [V(f"p{i}", "parameter", start=0.0, place=11 + i) for i in range(5)]
    able: dict[str, object] = {"canHandleVariableCommunicationStepSize": "true"}
    able |= SAVED if kind != "poor" else {}
    able |= ABLE.get(kind, {})
    if kind in ABLE:
        able["canInterpolateInputs"] = "true"
    experiment = f'stepSize="{step}"' if step else ""
    name = f"{model}_{kind}_{step}_{discrete}".replace(".", "_")
    description = Description(name, variables, {"CoSimulation": able}, token=model, experiment=experiment)
    members = {"modelDescription.xml": description.text(2), member(2, name): library().read_bytes()}
    return packed(folder / f"{name}.fmu", members)


def system(folder: Path, kind: str, case: Case) -> System:
    """A system of FMUs of a kind."""
    files, values = {}, dict(case.values)
    for name, (model, *parameters) in case.components.items():
        files[name] = fmu(folder, kind, str(model), case.steps.get(name, 1e-3), name == case.discrete)
        values |= {f"{name}.p{i}": float(p) for i, p in enumerate(parameters)}  # type: ignore[arg-type]
    return assemble(files, list(case.wires), values)


def outcome(name: str, kind: str, accuracy: float) -> tuple[str, str, float, str, float]:
    """System, kind, accuracy, what came out, and the wall time [s]."""
    case, began = SYSTEMS[name], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        try:
            result = run(
                system(Path(folder), kind, case), stop=case.stop, accuracy=accuracy,
                accuracy_of=[case.watched], time_limit=TIME_LIMIT,
            )  # fmt: skip
            cell = verdict(case, result, accuracy)
        except RunFailed as failed:
            cell = "refused"
            print(name, kind, accuracy, failed, file=sys.stderr)
        except Problem as problem:
            cell = f"ERROR {problem}"
    return name, kind, accuracy, cell, time.monotonic() - began


def verdict(case: Case, result: object, accuracy: float) -> str:
    """A cell of the table."""
    t, true = truth(case)
    times, values = result.trace.time, result.trace[case.watched]  # type: ignore[attr-defined]
    square = np.trapezoid(np.square(values - np.interp(times, t, true)), times) / (times[-1] - times[0])
    error = float(np.sqrt(square) / np.ptp(true))
    note = next(n for n in result.card.notes if n.startswith("accuracy "))  # type: ignore[attr-defined]
    print(case.watched, note, f"{error:.2e}", result.card.steps, file=sys.stderr)  # type: ignore[attr-defined]
    if "not known" in note:
        return "unknown"
    estimate = float(TOLD.search(note)[1])  # type: ignore[index]
    if error <= accuracy:
        return f"met {estimate / max(error, 1e-15):.2g}"
    return f"{'missed' if error < WRONG * accuracy else 'SILENT'} {error:.1e} ({estimate:.0e})"


def main() -> int:
    """Print the table."""
    parser = ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--only", default="")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    library()
    names = [name for name in SYSTEMS if given.only in name]
    cells: dict[tuple[str, str], list[str]] = {}
    with ProcessPoolExecutor(given.processes) as pool:
        started = [
            pool.submit(outcome, name, kind, a) for name in names for kind in given.kinds for a in ACCURACIES
        ]
        for done in started:
            name, kind, _, cell, wall = done.result()
            cells.setdefault((name, kind), []).append(cell)
            print(f"{wall:.1f} s: {name}, {kind}: {cell}", file=sys.stderr, flush=True)
    print("|".join(["", "system", *given.kinds, ""]) + "\n|---|" + "---|" * len(given.kinds))
    for name in names:
        print("|".join(["", name, *(", ".join(cells[name, kind]) for kind in given.kinds), ""]))
    counts = {
        kind: Counter(cell.split()[0] for (_, k), row in cells.items() if k == kind for cell in row)
        for kind in given.kinds
    }
    rows = [f"|{kind}|{'|'.join(str(of[word]) for word in OUTCOMES)}|" for kind, of in counts.items()]
    table = "\n".join([f"|FMUs|{'|'.join(OUTCOMES)}|", "|---|" + "--:|" * len(OUTCOMES), *rows])
    print(table)
    if names == list(SYSTEMS) and given.kinds == list(KINDS):
        before, rest = PAGE.read_text(encoding="utf-8").split(MARKS[0])
        after = rest[rest.index(MARKS[1]) :]
        PAGE.write_text(f"{before}{MARKS[0]}{table}\n{after}", encoding="utf-8")
    return int(any(of["SILENT"] + of["ERROR"] for of in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
