"""`make matrix`: runs everything, and writes the tables into docs/other-tools.md between their marks.

Tools are looked for among the packages of this Python and on the search path: OMSimulator, fmusim, fmuCheck,
omc, MasterSimulator, and, where a tool has a Python of its own, `pyfmi-python` and `cofmupy-python`.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fmpy import read_model_description

from benchmarks.matrix.present import NEVER, TOOLS, Tool
from fmus.build import data
from fmus.machine import COMMAND_WIRES, CONNECTIONS, SUPPLY_WIRES

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "other-tools.md"
STEP = 1e-3  # s
ALONE, STROKE, CYCLE, SHORT = 1.0, 6.0, 42.0, 8.0  # s
LIMIT = 900  # s of wall time for one run
WIRES = CONNECTIONS + COMMAND_WIRES + SUPPLY_WIRES
RATES = ("_rate", "_acceleration")
MOVED = ("boom_command", (0.0, 0.5, 0.8, 1.7, 2.0, 6.0), (0.0, 0.0, 4.0, 4.0, 0.0, 0.0))
JOINTS = ("swing", "boom", "stick")
SIGNALS = (
    *(f"manipulator.{j}_{kind}" for kind in ("speed", "angle") for j in JOINTS),
    *("swing.swing_pressure_a", "swing.swing_pressure_b"),
    *(f"boom_stick.{a}_{side}_pressure" for a in ("boom", "stick") for side in ("head", "rod")),
)
KINDS = ("speed", "angle", "pressure")


@dataclass(frozen=True)
class Outcome:
    """Rows by name, wall time [s], and why there are none."""

    rows: Mapping[str, np.ndarray]
    wall: float
    problem: str = ""


def carried_out(tool: Tool, folder: Path, **job: object) -> Outcome:
    """One job in a process of its own."""
    place = Path(tempfile.mkdtemp(dir=folder))
    file, out = place / "job.json", place / "rows.csv"
    told = {"parts": {}, "wires": [], "input": None, "master": "jacobi", "side": "CS"} | job
    file.write_text(json.dumps(told | {"tool": tool.key, "out": str(out)}))
    # some tools order FMUs by their hashes
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONHASHSEED": "0",
    }
    command = [tool.python, "-m", "benchmarks.matrix.tools", str(file)]
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=LIMIT, env=environment, cwd=place
        )
    except subprocess.TimeoutExpired:
        return Outcome({}, LIMIT, f"not done in {LIMIT} s")
    if run.returncode or not out.is_file():
        said = [line for line in (run.stderr or run.stdout).splitlines() if line.strip()]
        return Outcome({}, 0.0, said[-1].strip() if said else f"exit status {run.returncode}")
    with out.open(encoding="utf-8") as lines:
        names = lines.readline().strip().split(",")
        values = np.atleast_2d(np.loadtxt(lines, delimiter=","))
    shutil.rmtree(place, ignore_errors=True)
    return Outcome(dict(zip(names, values.T, strict=True)), float(run.stdout.split()[-1]))


# ---- systems


def held(system: Path, folder: Path) -> Path:
    """A copy of an SSP without the wires to rate ports."""
    target = folder / "held" / system.name
    target.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(system) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "SystemStructure.ssd":
                wire = rb'\s*<ssd:Connection [^>]*endConnector="\w*(?:_rate|_acceleration)"[^>]*(?:/>|>.*?</ssd:Connection>)'
                content = re.sub(wire, b"", content, flags=re.S)
            new.writestr(name, content)
    return target


def errors(rows: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Worst NRMSE over the range of the reference by kind of signal."""
    with data("reference/work_cycle.csv").open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        truth = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
    time = rows["time"]
    on = (truth["time"] >= time[0] - 1e-9) & (truth["time"] <= time[-1] + 1e-9)
    found = {kind: 0.0 for kind in KINDS}
    for name in SIGNALS:
        error = np.interp(truth["time"][on], time, rows[name]) - truth[name][on]
        kind = next(k for k in KINDS if k in name)
        found[kind] = max(found[kind], float(np.sqrt(np.mean(error**2)) / np.ptp(truth[name][on])))
    return found


def systems(build: Path, folder: Path) -> Iterator[tuple[str, ...]]:
    """Tool, FMI, master, rates, speed, angle, pressure, times real time or remark."""
    for tool in present():
        stop = SHORT if tool.short else CYCLE
        for fmi in tool.systems:
            source = build / ("fmi3" if fmi == 3 else "") / "harvester.ssp"
            parts = {
                n: str(source.parent / f"{n}.fmu")
                for n in ("manipulator", "supply", "boom_stick", "swing", "levers")
            }
            for master in tool.masters:
                for rates in (True, False) if fmi == 2 and tool.key != "openmodelica" else (True,):
                    wires = [w for w in WIRES if rates or not w[1].endswith(RATES)]
                    path = source if rates else held(source, folder)
                    job = {"path": str(path), "fmi": fmi, "stop": stop, "step": STEP, "record": SIGNALS}
                    found = carried_out(tool, folder, **job, parts=parts, wires=wires, master=master)
                    yield (
                        tool.name,
                        f"{fmi}.0",
                        "none" if tool.key == "openmodelica" else master,
                        "" if tool.key == "openmodelica" else "wired" if rates else "open",
                        f"{stop:g} s",
                        *_accuracy(found, stop),
                    )


def _accuracy(found: Outcome, stop: float) -> tuple[str, str, str, str]:
    if found.problem:
        return ("", "", "", _remark(found.problem))
    if found.rows["time"][-1] < 0.99 * stop or not all(np.isfinite(c).all() for c in found.rows.values()):
        return ("", "", "", "diverges")
    worst = errors(found.rows)
    if max(worst.values()) > 1:
        return ("", "", "", "diverges")
    speed = f"{_two(stop / found.wall)} x real time"
    return (*(_percent(worst[kind]) for kind in KINDS), speed)


def _percent(share: float) -> str:
    return f"{100 * share:.2g}"


def _two(value: float) -> str:
    """Two digits, the second one of a slow tool only."""
    return f"{value:.0f}" if value >= 3 else f"{value:.1g}"


def _remark(problem: str) -> str:
    text = re.sub(r"^\w*Error: |\[FMU\]\[\w+\]\[FMU status:\w+\] |(/[\w.+-]+)+/", "", problem).replace(
        "|", "/"
    )
    return text if len(text) < 110 else text[:107] + "..."


# ---- each FMU alone


def alone(build: Path, folder: Path) -> Iterator[tuple[str, ...]]:
    """Tool and side, how many FMUs ran, the largest deviation, what the others say."""
    truth: dict[tuple[int, str], Outcome] = {}
    ours = next(t for t in TOOLS if t.key == "harvester")
    for tool in present():
        for fmi, side in tool.alone:
            top = build / ("fmi3" if fmi == 3 else "")
            paths = [*sorted(top.glob("*.fmu")), *sorted((top / "variants").glob("*.fmu"))]
            ran, worst, wall, problems = 0, (0.0, ""), 0.0, dict[str, list[str]]()
            for path in paths:
                described = read_model_description(str(path), validate=False)
                outputs = [v for v in described.modelVariables if v.causality == "output"]
                job = {
                    "path": str(path),
                    "fmi": fmi,
                    "stop": ALONE,
                    "step": STEP,
                    "record": [v.name for v in outputs],
                }
                key = (2, path.name)
                if key not in truth:
                    own = {**job, "path": str(build / path.relative_to(top)), "fmi": 2}
                    truth[key] = carried_out(ours, folder, **own)
                found = carried_out(tool, folder, **job, side=side)
                wall += found.wall
                if not found.problem and found.rows["time"][-1] < 0.99 * ALONE:
                    found = Outcome({}, found.wall, f"ends at {found.rows['time'][-1]:.3g} s")
                if found.problem:
                    problems.setdefault(_remark(found.problem), []).append(path.stem)
                    continue
                ran += 1
                for v in outputs:
                    exact = np.interp(found.rows["time"], truth[key].rows["time"], truth[key].rows[v.name])
                    share = float(np.abs(found.rows[v.name] - exact).max() / float(v.nominal or 1))
                    worst = max(worst, (share, f"{path.stem}.{v.name}"))
            told = "; ".join(f"{', '.join(names)}: {text}" for text, names in problems.items())
            where = f"{worst[0]:.1g} ({worst[1]})" if ran and worst[0] > 0 else "0" if ran else ""
            yield (
                tool.name,
                f"{fmi}.0 {side}",
                f"{ran} of {len(paths)}",
                where,
                f"{wall / max(len(paths), 1):.2g} s",
                told,
            )


# ---- a lever is moved


def strokes(build: Path, folder: Path) -> Iterator[tuple[str, ...]]:
    """Tool and side, interval, largest and NRMSE error of the pressures, wall time."""
    record = [n.split(".")[1] for n in SIGNALS]
    ours = next(t for t in TOOLS if t.key == "harvester")
    base = {"path": str(build / "harvester.fmu"), "fmi": 2, "stop": STROKE, "record": record, "input": MOVED}
    truth = carried_out(ours, folder, **base, step=STEP).rows
    largest = {kind: max(np.ptp(truth[n]) for n in record if kind in n) for kind in KINDS}
    moved = [
        n for n in record if np.ptp(truth[n]) > 0.01 * next(x for kind, x in largest.items() if kind in n)
    ]
    for tool in present():
        for fmi, side in tool.strokes:
            for interval in (1e-3, 1e-2):
                path = build / ("fmi3" if fmi == 3 else "") / "harvester.fmu"
                found = carried_out(
                    tool, folder, **{**base, "path": str(path), "fmi": fmi}, side=side, step=interval
                )
                if found.problem:
                    yield (
                        tool.name,
                        f"{fmi}.0 {side}",
                        f"{1e3 * interval:g} ms",
                        "",
                        "",
                        _remark(found.problem),
                    )
                    continue
                worst, rms = 0.0, 0.0
                time, last = found.rows["time"], np.append(np.diff(found.rows["time"]) > 1e-9, True)
                for name in moved:
                    error = (found.rows[name] - np.interp(time, truth["time"], truth[name]))[last]
                    worst = max(worst, float(np.abs(error).max() / np.ptp(truth[name])))
                    rms = max(rms, float(np.sqrt(np.mean(error**2)) / np.ptp(truth[name])))
                yield (
                    tool.name,
                    f"{fmi}.0 {side}",
                    f"{1e3 * interval:g} ms",
                    _percent(worst),
                    _percent(rms),
                    f"{found.wall:.2g} s",
                )


# ---- the page


def present() -> list[Tool]:
    """The tools that are here and asked for."""
    return [t for t in TOOLS if t.found() and (not ASKED or t.key in ASKED)]


def versions() -> Iterator[tuple[str, ...]]:
    """Tool and version, or that it was not run."""
    for name in dict.fromkeys(t.name for t in TOOLS):
        tool = next(t for t in TOOLS if t.name == name)
        yield (name, tool.found() or "not run: not found here")
    for name in NEVER:
        yield (name, "not run: nobody here has it")


TABLES = {
    "versions": (("tool", "version"), versions),
    "systems": (
        (
            "tool",
            "FMI",
            "master",
            "rate ports",
            "run",
            "speed [%]",
            "angle [%]",
            "pressure [%]",
            "speed, or what happens",
        ),
        systems,
    ),
    "strokes": (
        ("tool", "FMI", "output interval", "largest [%]", "NRMSE [%]", "wall time, or what happens"),
        strokes,
    ),
    "alone": (
        (
            "tool",
            "FMI",
            "ran",
            "largest deviation over nominal value",
            "wall time each",
            "what the others say",
        ),
        alone,
    ),
}
ASKED: Sequence[str] = ()


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Run what is asked for."""
    global ASKED
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=Path, default=ROOT / "build", help="folder of the FMUs")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--table", action="append", choices=list(TABLES), help="only these; default: all")
    parser.add_argument(
        "--tool", action="append", choices=[t.key for t in TOOLS], help="only these, printed only"
    )
    asked = parser.parse_args()
    ASKED = asked.tool or ()
    with tempfile.TemporaryDirectory() as name:
        for key in asked.table or TABLES:
            head, rows = TABLES[key]
            found = []
            arguments = () if key == "versions" else (asked.build.resolve(), Path(name))
            for row in rows(*arguments):  # type: ignore[operator]
                found.append(row)
                print(" | ".join(row), flush=True)
            if not ASKED:
                _write(asked.page, key, table(head, found))
            if not ASKED and key == "systems":
                _write(asked.page.with_name("rate-ports.md"), "rates", table(RATE_HEAD, by_tool(found)))


def _write(page: Path, key: str, text: str) -> None:
    """Put a table between its marks."""
    begin, end = f"<!-- matrix: {key} -->\n", f"<!-- end: {key} -->"
    old = page.read_text(encoding="utf-8")
    if begin not in old or end not in old:
        raise SystemExit(f"{page}: expected the marks {begin.strip()} and {end}")
    before, _, rest = old.partition(begin)
    _, _, after = rest.partition(end)
    page.write_text(f"{before}{begin}{text}\n{end}{after}", encoding="utf-8")


RATE_HEAD = ("tool", "master", "run", "rates wired [%]", "rates open [%]", "so")


def by_tool(rows: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """Error of the joint speeds with and without rate ports, FMI 2.0, and what follows."""
    found: dict[tuple[str, str, str], dict[str, str]] = {}
    for name, fmi, master, rates, run, speed, *_, remark in rows:
        if fmi == "2.0" and rates:
            found.setdefault((name, master, run), {})[rates] = speed or remark
    result = []
    for key, errors_ in found.items():
        wired, open_ = errors_.get("wired", ""), errors_.get("open", "")
        shares = [float(x) if x[:1].isdigit() else float("inf") for x in (wired, open_)]
        result.append((*key, wired, open_, "connect" if shares[0] < shares[1] else "leave open"))
    return result


if __name__ == "__main__":
    main()
