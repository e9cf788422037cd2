"""Do two checkouts compute the same, to the last bit? `python -m benchmarks.same_results`.

    python -m benchmarks.same_results write new
    cd OTHER_CHECKOUT && python HERE/benchmarks/same_results.py write old
    python -m benchmarks.same_results compare old new

Each checkout runs its own FMUs in build/, and foreign ones that its tests compile: all masters with each of
their settings, adaptive steps, guards, accuracies, estimates of errors, conditions, faults, variants, saved
states, clocks, events, texts, arrays, Model Exchange, references, linear models, machines in lanes and alone,
studies and files. Of each result are compared all arrays, and events, texts, notes and statuses as text;
what depends on the time of day or the folder is left out. `--only PATTERN` chooses cases.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import partial
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import orchestrator
from orchestrator import (
    Master,
    Problem,
    System,
    assemble,
    batch,
    linearize,
    load,
    read_trace,
    reference,
    run,
    sweep,
    validate,
    write_ssp,
)

CHECKOUT = Path.cwd()  # of `write`: the one whose results are written
sys.path.insert(0, str(CHECKOUT / "tests"))

MASTERS = ("jacobi", "gauss-seidel", "hermite", "interface-jacobian")
CYCLE = "data/scenarios/work_cycle.csv"
STEPS = (5e-4, 1e-3, 2e-3)
SPEEDS = re.compile(
    r"\d+(\.\d+)?(e[+-]\d+)? ?(s wall|times real time|runs/s)"
)  # what the clock on the wall says


@dataclass
class Found:
    """What a case gave: arrays by name, and texts."""

    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    texts: list[str] = field(default_factory=list)


def of_run(result: Any) -> Found:
    """What a run gave: its trace, and what its card says."""
    card, trace = result.card, result.trace
    arrays = {"time": trace.time, **trace.signals}
    if result.errors is not None:
        arrays |= {f"error of {name}": values for name, values in result.errors.signals.items()}
    texts = [str(trace.units), str(card.steps), str(card.passes), str(card.repeated)]
    groups = (card.events, card.texts, card.notes, card.unreliable, card.bonds, card.errors, result.messages)
    texts += [str(item) for group in groups for item in group]
    return Found(arrays, [*texts, *map(str, card.unseen.items())])


def of_batch(result: Any) -> Found:
    """What machines gave: signals, statuses, reasons."""
    arrays = {"time": result.time, **result.signals}
    return Found(arrays, [*result.status.tolist(), *result.reasons, *result.notes])


def of_study(results: Any) -> Found:
    """What a study gave: its table, and its signals over time."""
    tables = {"runs": results.table, "bands": results.bands}
    arrays = {
        f"{kind} {name}": column.to_numpy()
        for kind, table in tables.items()
        for name, column in ([] if table is None else table.items())
    }
    texts = [f"{n} {a.tolist()}" for n, a in arrays.items() if a.dtype == object]
    return Found({n: a for n, a in arrays.items() if a.dtype != object}, texts)


def of_file(path: Path) -> Found:
    """The bytes of a file."""
    return Found(texts=[f"{path.name} {sha256(path.read_bytes()).hexdigest()}"])


def halving(components: Any, time: float, length: float) -> None:
    """A master of one's own: each component takes two half steps, then sends its outputs."""
    for name, component in components.items():
        component.step(time, 0.5 * length)
        component.step(time + 0.5 * length, 0.5 * length)
        components.send(name)


# ---- the cases

Cases = Iterator[tuple[str, Callable[[], Found]]]


def coupled(
    system: str | System, name: str, masters: Mapping[str, Mapping[str, Any]], **common: Any
) -> Cases:
    """A system with each master and its settings."""
    for label, options in masters.items():
        yield f"{name} {label}", lambda options=options: of_run(run(system, **{**common, **options}))


def settings() -> dict[str, dict[str, Any]]:
    """All masters with the settings that they take."""
    found: dict[str, dict[str, Any]] = {}
    for master, step in product(MASTERS, STEPS):
        found[f"{master} {step:g}"] = {"master": master, "step": step}
    for master, order in product(MASTERS[:2], (0, 1, 2)):
        found[f"{master} order {order}"] = {"master": master, "order": order, "step": 1e-3}
    for passes in (2, 8):
        found[f"hermite {passes} passes"] = {"master": "hermite", "passes": passes, "step": 2e-3}
    for master in MASTERS:
        found[f"{master} adaptive"] = {"master": master, "adaptive": 1e-4, "step": 1e-3, "record_step": 0.01}
        found[f"{master} error"] = {"master": master, "step": 1e-3, "error_estimate": True}
        found[f"{master} recorded"] = {"master": master, "step": 1e-3, "record_step": 0.01}
    found["accuracy 1e-3"] = {"accuracy": 1e-3}
    found["accuracy 1e-5 of speeds"] = {"accuracy": 1e-5, "accuracy_of": "*_speed"}
    return found


def machine(build: Path, folder: Path) -> Cases:
    """The harvester."""
    ssp, common = str(build / "harvester.ssp"), {"scenario": CYCLE, "stop": 2.0}
    yield from coupled(ssp, "machine", settings(), **common)
    given: dict[str, dict[str, Any]] = {
        "default": {},
        "in this process": {"isolate": False, "step": 1e-3},
        "until": {"until": "swing.swing_pressure_a > 100 bar"},
        "swap": {"swap": {"boom_stick": "detailed"}},
        "set": {"set": {"manipulator.head_mass": 600.0, "supply.pressure_setting": "180bar"}},
        "cut": {"cut": "boom_stick.boom_command", "step": 1e-3},
        "record": {"record": ["*_pressure", "manipulator.*"], "step": 1e-3},
        "tolerance": {"tolerance": 1e-8, "step": 1e-3},
        "start": {"start": 1.0, "step": 1e-3},
        "own master": {"master": Master("halving", step=halving), "isolate": False, "step": 1e-3},
    }
    yield from coupled(ssp, "machine", given, **common)

    state = folder / "run.state"

    def saved() -> Found:
        options = {**common, "step": 1e-3, "master": "hermite"}
        first = of_run(run(ssp, save_state=f"{state}@1s", **options))
        second = of_run(run(ssp, resume=state, **options))
        arrays = {f"resumed {name}": values for name, values in second.arrays.items()}
        return Found(first.arrays | arrays, first.texts + second.texts)

    yield "machine saved and resumed", saved
    yield "machine as one ODE", lambda: of_run(reference(ssp, CYCLE, stop=0.5))
    yield "machine validated", lambda: _validated(ssp)
    yield "machine compared", lambda: _compared(ssp)
    yield "machine linear", lambda: _linear(linearize(ssp))
    yield "machine linear in a run", lambda: _linear(linearize(ssp, time=0.5))
    masses = {"manipulator.head_mass": np.linspace(300.0, 900.0, 11)}
    few = {"stop": 0.5, "step": 1e-3, "record": ["manipulator.*", "swing.*"]}
    for lanes in (True, False):
        values = masses if lanes else {name: array[:3] for name, array in masses.items()}
        yield f"batch lanes={lanes}", partial(_batched, ssp, values, few, lanes)
    for kind in ("csv", "parquet", "mat"):
        yield f"file {kind}", partial(_written, ssp, folder, kind)
    yield "file ssp", lambda: _rewritten(ssp, folder)
    for method in ("latin", "saltelli", "morris", "grid"):
        yield f"study {method}", partial(_studied, ssp, folder, method)


def _batched(ssp: str, values: Mapping[str, Any], options: Mapping[str, Any], lanes: bool) -> Found:
    return of_batch(batch(ssp, values, CYCLE, lanes=lanes, **options))


def _validated(ssp: str) -> Found:
    validation = validate(run(ssp, CYCLE, stop=3.0, step=1e-3), "data/reference/work_cycle.csv")
    return Found(texts=[validation.verdict, *map(str, validation.rows)])


def _compared(ssp: str) -> Found:
    runs = {str(step): run(ssp, CYCLE, stop=1.0, step=step) for step in STEPS}
    comparison = orchestrator.compare(runs)
    return Found(texts=[str(row) for of in comparison.against.values() for row in of.rows])


def _linear(linear: Any) -> Found:
    return Found({name: np.asarray(getattr(linear, name)) for name in "abcd"})


def _written(ssp: str, folder: Path, kind: str) -> Found:
    file = run(ssp, CYCLE, stop=0.5, step=1e-3).write(folder / f"run.{kind}")
    trace = read_trace(file)
    texts = of_file(file).texts if kind == "csv" else []  # others hold the time of day
    return Found({"time": trace.time, **trace.signals}, texts)


def _rewritten(ssp: str, folder: Path) -> Found:
    file = folder / "again.ssp"
    write_ssp(load(ssp), file)
    return of_run(run(str(file), CYCLE, stop=0.5, step=1e-3))


def _studied(ssp: str, folder: Path, method: str) -> Found:
    ranges = {"manipulator.head_mass": (300.0, 900.0), "supply.pressure_setting": (15e6, 20e6)}
    numbers = "values = [{0}, {1}]" if method == "grid" else "minimum = {0}, maximum = {1}"
    kind = "values" if method == "grid" else "uniform"
    factors = [
        f'"{name}" = {{ distribution = "{kind}", {numbers.format(*ends)} }}' for name, ends in ranges.items()
    ]
    lines = [
        f'system = "{Path(ssp).resolve().as_posix()}"',
        f'method = "{method}"',
        *([] if method == "grid" else ["runs = 16"]),
        *("stop = 0.2", "step = 1e-3", "[factors]", *factors, "[outputs]"),
        'peak = { signal = "swing.swing_pressure_a", measure = "maximum", band = true }',
        'end = { signal = "manipulator.boom_angle", measure = "final" }',
    ]
    file = folder / f"{method}.toml"
    file.write_text("\n".join(lines), encoding="utf-8")
    return of_study(sweep(file, folder / method))


def foreign(folder: Path) -> Cases:
    """FMUs of others: two masses, arrays, clocks, texts, events, Model Exchange."""
    from kit.any_fmu.models import (
        Workshop,
        bank_fmu,
        oscillator_of,
        stopping_fmu,
        telling,
        ticking_fmu,
    )

    for fmi in (2, 3):
        place = folder / f"masses{fmi}"
        place.mkdir()
        workshop = Workshop(place, fmi)
        plain = oscillator_of(workshop["mass_a"], workshop["mass_b"])
        told = oscillator_of(telling(workshop, "mass_a"), telling(workshop, "mass_b"))
        for name, system in (("plain", plain), ("with derivatives", told)):
            for master in MASTERS if system is told else MASTERS[:3]:
                for label, options in {
                    "": {"step": 0.01},
                    " adaptive": {"step": 0.01, "adaptive": 1e-5},
                    " error": {"step": 0.01, "error_estimate": True},
                }.items():
                    given = {"master": master, "stop": 1.0, **options}
                    of = partial(_of_options, system, given)
                    yield f"masses FMI {fmi} {name} {master}{label}", of
            yield (
                f"masses FMI {fmi} {name} default",
                partial(_of_options, system, {"step": 0.01, "stop": 1.0}),
            )
            yield f"masses FMI {fmi} {name} batch", partial(_masses, system, {"a.mass": [1.0, 1.5, 2.0]})

    lag = bank_fmu(folder / "bank.fmu")
    sends = {'valueReference="2" dependencies="1 3"': 'valueReference="2" dependencies="1"'}
    tenth = 'intervalVariability="constant" intervalDecimal="{}"'
    clocks = {}
    for name, interval in (("p", "0.1"), ("q", "0.15"), ("slow", "0.05")):
        (folder / name).mkdir()
        clocks[name] = ticking_fmu(folder / name / "unit.fmu", tenth.format(interval), **sends)
    ends = (("fired", "come"), ("frame", "data"))
    bus = [f"{a}.{out} -> {b}.{to}" for a, b in ("pq", "qp") for out, to in ends]
    nodes = assemble({"p": clocks["p"], "q": clocks["q"]}, bus)
    wires = [("lag.y[1]", "unit.u"), ("unit.y", "lag.u[1]", -0.5, 1.0)]
    start = {"lag.n": 1, "lag.k": "1", "lag.m": "1 0"}
    sampled = assemble({"lag": lag, "unit": clocks["slow"]}, wires, start)
    stopping = {
        name: stopping_fmu(folder / f"{name}.fmu", name)
        for name in ("room", "heater", "relay", "ball", "ticker", "sum", "copy")
    }
    heated = [("room.T", "relay.y"), ("relay.on", "room.on")]
    ticked = [("ticker.level", "sum.u")]
    systems = {
        "bus": nodes,
        "sampled": sampled,
        "room": assemble({n: stopping[n] for n in ("room", "relay")}, heated),
        "ticker": assemble({n: stopping[n] for n in ("ticker", "sum")}, ticked),
        "ball": load(stopping["ball"]),
        "arrays": load(lag),
    }
    for (name, system), master in product(systems.items(), MASTERS[:3]):
        for step in (0.01, 0.03):
            options = {"master": master, "step": step, "stop": 1.2}
            yield f"{name} {master} {step:g}", partial(_of_options, system, options)


def _masses(system: System, machines: Mapping[str, Any]) -> Found:
    return of_batch(batch(system, machines, step=0.01, stop=0.5))


def _of_options(system: System, options: Mapping[str, Any]) -> Found:
    return of_run(run(system, **options))


# ---- write and compare


def write(target: Path, build: Path, only: str) -> None:
    """Write what each case gave, or the line with which it was refused."""
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, case in (*machine(build, folder), *foreign(folder)):
            if not fnmatchcase(name, only):
                continue
            try:
                found = case()
            except Problem as problem:
                found = Found(texts=[f"refused: {problem}"])
            places = (str(folder), "<folder>"), (str(CHECKOUT), "<checkout>")
            texts = [SPEEDS.sub("<time>", _replaced(text, places)) for text in found.texts]
            file = target / name.replace(" ", "_")
            np.savez(file.with_name(f"{file.name}.npz"), **found.arrays)
            text = json.dumps(texts, indent=0)
            file.with_name(f"{file.name}.json").write_text(text, encoding="utf-8")
            print(f"{name}: {len(found.arrays)} arrays, {len(texts)} texts", flush=True)


def _replaced(text: str, places: tuple[tuple[str, str], ...]) -> str:
    for place, name in places:
        text = text.replace(place, name)
    return text


def compare(old: Path, new: Path) -> bool:
    """Print the cases that differ, and how; whether there is none."""
    names = sorted({file.stem for folder in (old, new) for file in folder.glob("*.json")})
    differing = 0
    for name in names:
        difference = "; ".join(_differences(old / name, new / name))
        differing += bool(difference)
        if difference:
            print(f"{name}: {difference}")
    print(f"{len(names)} cases, {differing} differ")
    return bool(names) and not differing


def _differences(old: Path, new: Path) -> Iterator[str]:
    files = [[path.with_name(f"{path.name}.{kind}") for kind in ("npz", "json")] for path in (old, new)]
    if not all(file.exists() for pair in files for file in pair):
        yield "in one of both only"
        return
    with np.load(files[0][0]) as first, np.load(files[1][0]) as second:
        if first.files != second.files:
            yield f"arrays {sorted({*first.files} ^ {*second.files})[:5] or 'in another order'}"
        for name in first.files:
            if name in second.files and first[name].tobytes() != second[name].tobytes():
                yield f"{name} {_largest(first[name], second[name])}"
                break
    texts = [json.loads(pair[1].read_text("utf-8")) for pair in files]
    if texts[0] != texts[1]:
        lines = next((pair for pair in zip(*texts, strict=False) if pair[0] != pair[1]), None)
        yield f"text {lines[0]!r} -> {lines[1]!r}" if lines else f"{len(texts[0])} -> {len(texts[1])} texts"


def _largest(a: np.ndarray, b: np.ndarray) -> str:
    if a.shape != b.shape:
        return f"shape {a.shape} -> {b.shape}"
    if a.dtype.kind not in "fiu":
        return "differs"
    return f"differs by {np.nanmax(np.abs(a - b)):.3g} of {np.nanmax(np.abs(a)):.3g}"


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.same_results", description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    writing = commands.add_parser("write")
    writing.add_argument("folder", type=Path)
    writing.add_argument("--build", type=Path, default=Path("build"), help="folder of the FMUs")
    writing.add_argument("--only", default="*", metavar="PATTERN")
    comparing = commands.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    given = parser.parse_args()
    if given.command == "compare":
        return 0 if compare(given.old, given.new) else 1
    write(given.folder, given.build, given.only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
