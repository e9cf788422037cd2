"""One run in one tool, in a process and perhaps a Python of its own: `python -m benchmarks.matrix.tools JOB.json`.

The job says what to run; rows and wall time go to files beside it. A tool that fails, fails with its own message.
Needs NumPy only, beside the tool.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

SSD = {"ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription"}
GRID = 0.01  # s, of the rows of a single FMU


@dataclass(frozen=True)
class Job:
    """One run.

    path     an .fmu, or an .ssp whose components lie in `parts`
    side     ME or CS of an FMU
    wires    of the system
    record   outputs of the FMU, or "component.variable"
    input    of a stroke: name, times and values; without, inputs keep their start values
    master   jacobi or gauss-seidel, where a tool has both
    ordered  the FMUs are to be stepped in the order of `parts`, where a tool can be told
    """

    tool: str
    path: str
    fmi: int
    side: str
    stop: float
    step: float
    record: Sequence[str]
    out: str
    parts: Mapping[str, str]
    wires: Sequence[Sequence[str]]
    input: Any = None
    master: str = "jacobi"
    ordered: bool = False

    @property
    def is_system(self) -> bool:
        """An SSP?"""
        return self.path.endswith(".ssp")

    def series(self) -> tuple[str, np.ndarray, np.ndarray]:
        """Name, times and values of the moved input."""
        name, at, values = self.input
        return name, np.array(at), np.array(values)


Rows = Mapping[str, Any]  # "time" and the signals of `record`
RUNNERS: dict[str, Callable[[Job], Rows]] = {}


def runner(run: Callable[[Job], Rows]) -> Callable[[Job], Rows]:
    """Enter a function by its name."""
    RUNNERS[run.__name__] = run
    return run


def main() -> None:
    """Run a job and write its rows."""
    job = Job(**json.loads(Path(sys.argv[1]).read_text()))
    begin = time.perf_counter()
    with contextlib.redirect_stdout(sys.stderr):
        rows = RUNNERS[job.tool](job)
    wall = time.perf_counter() - begin
    names = ("time", *job.record)
    columns = np.column_stack([np.asarray(rows[name], dtype=float) for name in names])
    np.savetxt(job.out, columns, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    Path(job.out).with_name("wall.txt").write_text(str(wall))  # programs write to stdout what they like


# ---- FMPy


@runner
def fmpy(job: Job) -> Rows:
    """simulate_fmu with default settings, simulate_ssp."""
    import fmpy as tool

    if job.is_system:
        from fmpy.ssp.simulation import simulate_ssp

        rows = simulate_ssp(job.path, stop_time=job.stop, step_size=job.step)
        # a row carries the time at the begin of its step and the values at its end
        return {"time": rows["time"] + job.step} | {name: rows[name] for name in job.record}
    options: dict[str, Any] = {}
    if job.input:
        name, at, values = job.series()
        options["input"] = np.array(
            list(zip(at, values, strict=True)), dtype=[("time", float), (name, float)]
        )
    kind = {"ME": "ModelExchange", "CS": "CoSimulation"}[job.side]
    interval = job.step if job.input else GRID
    rows = tool.simulate_fmu(
        job.path,
        fmi_type=kind,
        stop_time=job.stop,
        output_interval=interval,
        output=list(job.record),
        **options,
    )
    return {name: rows[name] for name in rows.dtype.names}


@runner
def fmpy_container(job: Job) -> Rows:
    """The parts in one FMU."""
    from copy import copy

    import fmpy as tool
    from fmpy.container_fmu.cli import create_container_fmu
    from fmpy.container_fmu.config import Component, Configuration, Connection
    from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable

    parts, variables = {}, {}
    for name, path in job.parts.items():
        description = tool.read_model_description(path)
        parts[name] = Component(name, Path(path), description)
        variables |= {f"{name}.{v.name}": v for v in description.modelVariables}

    def end(port: str) -> tuple[Any, list[Any]]:
        variable = copy(variables[port])
        variable.type = "Float64"
        return parts[port.split(".")[0]], [variable]

    real = "Real" if job.fmi == 2 else "Float64"
    clock = ModelVariable(name="time", type=real, causality="independent", variability="continuous")
    shown = {"causality": "output", "initial": "calculated", "variability": "continuous"}
    mapped = {
        ModelVariable(name=n.replace(".", "_"), type=real, **shown): [(parts[n.split(".")[0]], variables[n])]
        for n in job.record
    }
    made = ModelDescription(
        fmiVersion=f"{job.fmi}.0",
        modelName="system",
        instantiationToken="system",
        modelVariables=[clock, *mapped],
        coSimulation=CoSimulation(fixedInternalStepSize=job.step),
    )
    wires = [Connection(*end(a), *end(b)) for a, b in sorted(job.wires, key=_rank)]
    folder = Path(job.out).with_suffix("")
    (folder / "unpacked").mkdir(parents=True)
    target = folder / "system.fmu"
    create_container_fmu(
        Configuration(False, made, list(parts.values()), wires, mapped), folder / "unpacked", target
    )
    return _contained(job, target, {n: n.replace(".", "_") for n in job.record})


def _rank(wire: tuple[str, str]) -> int:
    """The container carries one connection after the other: motion, force, acceleration, rates."""
    ranks = {"force": 1, "torque": 1, "acceleration": 2, "rate": 3}
    return ranks.get(wire[0].rsplit("_", 1)[-1], 0)


def _contained(job: Job, target: Path, shown: Mapping[str, str]) -> Rows:
    import fmpy as tool

    rows = tool.simulate_fmu(
        str(target), validate=False, stop_time=job.stop, output_interval=job.step, output=list(shown.values())
    )
    return {"time": rows["time"]} | {name: rows[column] for name, column in shown.items()}


@runner
def fmucontainer(job: Job) -> Rows:
    """fmu-manipulation-toolbox: an SSP in one FMU."""
    import fmpy as tool
    from fmu_manipulation_toolbox.assembly import Assembly

    folder = Path(job.out).with_suffix("")
    folder.mkdir(parents=True)
    shutil.copy(job.path, folder / "system.ssp")
    made = Assembly("system.ssp", default_step_size=job.step, fmu_directory=folder)
    made.root.auto_input = made.root.auto_output = True
    made.make_fmu(fmi_version=job.fmi)
    (target,) = folder.glob("*.fmu")
    known = {v.name for v in tool.read_model_description(str(target), validate=False).modelVariables}
    return _contained(job, target, {n: n if n in known else n.split(".")[1] for n in job.record})


# ---- Ecos and libcosim


@runner
def ecos(job: Job) -> Rows:
    """By its Python package: an SSP 1.0, else the parts and their wires."""
    import ecospy as tool

    tool.EcosLib.set_log_level("warn")
    if job.is_system and job.fmi == 2:
        made: dict[str, Any] = {"ssp_path": job.path}
    else:
        made = {"structure": tool.EcosSimulationStructure()}
        for name, path in (job.parts if job.is_system else {"it": job.path}).items():
            made["structure"].add_model(name, path)
        for a, b in job.wires:
            made["structure"].make_real_connection(a.replace(".", "::"), b.replace(".", "::"))
    names = [n.replace(".", "::") if job.is_system else f"it::{n}" for n in job.record]
    every = max(1, round((0.02 if job.is_system else GRID) / job.step))
    with tool.EcosSimulation(step_size=job.step, **made) as simulation:
        if not simulation.init():
            raise RuntimeError(tool.EcosLib.get_last_error())
        rows = []
        for n in range(1, round(job.stop / job.step) // every + 1):
            simulation.step(every)
            rows.append([n * every * job.step, *(simulation.get_real(name) for name in names)])
        simulation.terminate()
    return _named(job, rows)


def _named(job: Job, rows: Sequence[Sequence[float]]) -> Rows:
    return dict(zip(("time", *job.record), np.array(rows).T, strict=True))


@runner
def libcosim(job: Job) -> Rows:
    """By its Python package, with the step of the SSP."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.WARNING)
    if job.is_system:
        execution = CosimExecution.from_ssp_file(job.path)
    else:
        execution = CosimExecution.from_step_size(step_size=round(job.step * 1e9))
        execution.add_local_slave(CosimLocalSlave(fmu_path=job.path, instance_name="it"))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    places = {
        (f"{slave.name.decode()}." if job.is_system else "") + v.name.decode(): (slave.index, v.reference)
        for slave in execution.slave_infos()
        for v in execution.slave_variables(slave.index)
    }
    every = max(1, round((0.02 if job.is_system else GRID) / job.step))
    rows = []
    for n in range(1, round(job.stop / job.step) // every + 1):
        if not execution.step(every):
            raise RuntimeError("a step failed")
        rows.append(
            [
                n * every * job.step,
                *(observer.last_real_values(places[x][0], [places[x][1]])[0] for x in job.record),
            ]
        )
    return _named(job, rows)


# ---- OMSimulator, fmusim, fmuCheck: command lines


def _table(path: Path, job: Job, column: Callable[[str], str]) -> Rows:
    """Columns of a CSV file by name; of several rows at one time the last."""
    with path.open(encoding="utf-8") as lines:
        names = [n.strip().strip('"') for n in lines.readline().split(",")]
        rows = np.atleast_2d(np.loadtxt(lines, delimiter=","))
    rows = rows[np.append(np.diff(rows[:, 0]) > 1e-9, True)]
    at = {n: names.index(column(n)) for n in job.record}
    return {"time": rows[:, 0]} | {n: rows[:, k] for n, k in at.items()}


WRONG = re.compile(r"^\s*(error:|\[error\]|\[fatal\]|.*status:error)", re.I)


def _command(*words: str) -> None:
    """A command; an error in its log is a failure. The reason is that error, else what it said last."""
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    said = [line.strip() for line in (run.stdout + run.stderr).splitlines() if line.strip()]
    bad = [line for line in said if WRONG.match(line)]
    if run.returncode or bad:
        raise RuntimeError((bad[:1] or said[-1:] or [f"exit status {run.returncode}"])[0])


@runner
def omsimulator(job: Job) -> Rows:
    """Its command line; tolerance of Model Exchange as in the FMUs' experiment."""
    target = Path(job.out).with_suffix(".oms.csv")
    mode = [] if job.is_system else [f"--mode={job.side.lower()}", "--tolerance=1e-6"]
    _command(
        "OMSimulator",
        *mode,
        f"--stepSize={job.step}",
        f"--intervals={round(job.stop / (job.step if job.is_system else GRID)) + 1}",
        f"--stopTime={job.stop}",
        f"--resultFile={target}",
        job.path,
    )
    with target.open(encoding="utf-8") as lines:
        names = [n.strip().strip('"') for n in lines.readline().split(",")]
    ends = {n: next((c for c in names if c.endswith(f".{n}")), n) for n in job.record}
    return _table(target, job, ends.__getitem__)


@runner
def fmusim(job: Job) -> Rows:
    """Model Exchange by CVode at its default tolerance."""
    target = Path(job.out).with_suffix(".fmusim.csv")
    words = ["--interface-type", job.side.lower(), "--stop-time", str(job.stop), "--output-file", str(target)]
    words += ["--output-interval", str(job.step if job.input else GRID)]
    words += ["--solver", "cvode"] if job.side == "ME" else []
    if job.input:
        name, at, values = job.series()
        file = Path(job.out).with_suffix(".input.csv")
        np.savetxt(file, np.column_stack([at, values]), delimiter=",", header=f"time,{name}", comments="")
        words += ["--input-file", str(file)]
    _command("fmusim", *words, job.path)
    return _table(target, job, lambda n: n)


@runner
def fmucheck(job: Job) -> Rows:
    """Explicit Euler in Model Exchange."""
    target = Path(job.out).with_suffix(".check.csv")
    count = str(round(job.stop / GRID))
    _command(
        *(
            "fmuCheck",
            "-l",
            "2",
            "-k",
            job.side.lower(),
            "-s",
            str(job.stop),
            "-h",
            str(job.step),
            "-n",
            count,
        ),
        *("-o", str(target), job.path),
    )
    return _table(target, job, lambda n: n)


# ---- PyFMI, CoFmuPy, MasterSim


@runner
def pyfmi(job: Job) -> Rows:
    """CVode in Model Exchange, the Jacobi master for systems."""
    from pyfmi import load_fmu
    from pyfmi.master import Master

    log = str(Path(job.out).with_suffix(".txt"))
    if not job.is_system:
        model = load_fmu(job.path, kind=job.side, log_file_name=log)
        options = model.simulate_options()
        options["ncp"] = round(job.stop / (job.step if job.input else GRID))
        options["result_handling"] = "memory" if job.fmi == 2 else "binary"
        more: dict[str, Any] = {}
        if job.side == "ME":
            options["solver"] = "CVode"
            options["CVode_options"]["verbosity"] = 50
        if job.input:
            name, at, values = job.series()
            more["input"] = ([name], np.column_stack([at, values]))
        result = model.simulate(final_time=job.stop, options=options, **more)
        return {n: result[n] for n in ("time", *job.record)}
    parts = {n: load_fmu(p, kind="CS", log_file_name=f"{log}.{n}") for n, p in job.parts.items()}
    split = [(a.split("."), b.split(".")) for a, b in job.wires]
    master = Master(list(parts.values()), [(parts[a], x, parts[b], y) for (a, x), (b, y) in split])
    options = master.simulate_options()
    options |= {"step_size": job.step, "block_initialization": True, "result_handling": "memory"}
    result = master.simulate(final_time=job.stop, options=options)
    found = {n: result[parts[n.split(".")[0]]] for n in job.record}
    return {"time": next(iter(found.values()))["time"]} | {n: r[n.split(".")[1]] for n, r in found.items()}


def _inputs(path: str) -> dict[str, float]:
    """Start values of the inputs of an FMU."""
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    found = {}
    for v in root.iter():
        if v.attrib.get("causality") == "input":
            value = v if "start" in v.attrib else v[0]
            found[v.attrib["name"]] = float(value.attrib["start"])
    return found


@runner
def cofmupy(job: Job) -> Rows:
    """Both of its algorithms; it starts inputs at zero unless told.

    The FMUs of a loop it takes in the order of a set of names, another one in each run; an order of ours is put
    in its place, with all FMUs in one group.
    """
    from cofmupy import Coordinator

    config = {
        "fmus": [
            {"id": name, "path": path, "initialization": _inputs(path)} for name, path in job.parts.items()
        ],
        "connections": [
            {
                "source": dict(zip(("id", "variable"), a.split("."), strict=True)),
                "target": dict(zip(("id", "variable"), b.split("."), strict=True)),
            }
            for a, b in job.wires
        ],
        "data_storages": [],
        "cosim_method": {"jacobi": "jacobi", "gauss-seidel": "gauss_seidel"}[job.master],
    }
    file = Path(job.out).with_suffix(".cofmupy.json")
    file.write_text(json.dumps(config))
    coordinator = Coordinator()
    coordinator.start(str(file))
    if job.ordered:
        coordinator.master.sequence_order = [list(job.parts)]
    coordinator.run_simulation(step_size=job.step, end_time=job.stop)
    result = coordinator.get_results()
    columns = {n: np.asarray(result[tuple(n.split("."))]) for n in job.record}
    count = min(c.size for c in columns.values())
    # a row carries the time at the begin of its step and the values at its end
    return {"time": job.step * np.arange(1, count + 1)} | {n: c[:count] for n, c in columns.items()}


@runner
def mastersim(job: Job) -> Rows:
    """Its command line; Gauss-Seidel without iteration, each FMU in a cycle of its own, in the order of `parts`."""
    folder = Path(job.out).with_suffix("")
    folder.mkdir(parents=True)
    mode = {"jacobi": "GAUSS_JACOBI", "gauss-seidel": "GAUSS_SEIDEL"}[job.master]
    text = [
        "tStart 0 s",
        f"tEnd {job.stop} s",
        *(f"{word} {job.step} s" for word in ("hMax", "hStart", "hFallBackLimit")),
        "hMin 1e-9 s",
        "hOutputMin 0.02 s",
        *("adjustStepSize no", "preventOversteppingOfEndTime yes", "absTol 1e-06", "relTol 1e-05"),
        *(f"MasterMode {mode}", "ErrorControlMode NONE", "maxIterations 1", "writeInternalVariables no", ""),
        *(f'simulator {k} {k} {name} #ff447cb4 "{path}"' for k, (name, path) in enumerate(job.parts.items())),
        "",
        *(f"graph {a} {b}" for a, b in job.wires),
    ]
    project = folder / "system.msim"
    project.write_text("\n".join(text) + "\n")
    _command("MasterSimulator", "-x", "--verbosity-level=1", f"--working-dir={folder / 'out'}", str(project))
    file = folder / "out" / "results" / "values.csv"
    with file.open(encoding="utf-8") as lines:
        names = [re.sub(r"\s*\[.*\]$", "", n.strip().strip('"')) for n in lines.readline().split("\t")]
        rows = np.loadtxt(lines, delimiter="\t")
    return {"time": rows[:, 0]} | {n: rows[:, names.index(n)] for n in job.record}


# ---- OpenModelica


@runner
def openmodelica(job: Job) -> Rows:
    """Its import of an FMU 2.0 for Model Exchange; systems by the package of `harvester modelica`."""
    folder = Path(job.out).with_suffix("")
    (folder / "it").mkdir(parents=True)
    tolerance, intervals = "1e-8", round(job.stop / (0.02 if job.is_system else GRID))
    head = 'setCommandLineOptions("--allowNonStandardModelica=reinitInAlgorithms");\nloadModel(Modelica, {"4.0.0"});\n'
    if job.is_system:
        _command(sys.executable, "-m", "orchestrator", "modelica", job.path, "--out", str(folder))
        text = 'loadFile("Harvester/package.mo");\n'
        model = "Harvester.Systems." + "".join(p.capitalize() for p in Path(job.path).stem.split("_"))
        column = {n: n for n in job.record}
    else:
        text = f'loadFile(importFMU("{job.path}", "{folder}/it", fullPath = true));\n'
        with zipfile.ZipFile(job.path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        kind = root.find("ModelExchange").attrib["modelIdentifier"]  # type: ignore[union-attr]
        starts = _inputs(job.path)
        fed = "\n".join(f"  it.{n} = {x};" for n, x in starts.items())
        equations = f"equation\n{fed}\n" if fed else ""
        text += f'loadString("model Case\n  {kind}_me_FMU it;\n{equations}end Case;");\n'
        model, column = "Case", {n: f"it.{n}" for n in job.record}
    options = f"stopTime = {job.stop}, numberOfIntervals = {intervals}, tolerance = {tolerance}"
    script = folder / "run.mos"
    script.write_text(f'{head}{text}simulate({model}, {options}, outputFormat = "csv"); getErrorString();\n')
    run = subprocess.run(["omc", "run.mos"], cwd=folder, capture_output=True, text=True, check=False)
    file = folder / f"{model}_res.csv"
    if not file.is_file() or "The simulation finished successfully" not in run.stdout:
        lines = [line for line in run.stdout.splitlines() if "rror" in line]
        raise RuntimeError(lines[0] if lines else "no result")
    return _table(file, job, column.__getitem__)


# ---- our own master


@runner
def harvester(job: Job) -> Rows:
    """`harvester run`."""
    from orchestrator import Trace, load, run

    if job.is_system:
        trace = run(
            load(job.path), master=job.master, step=job.step, stop=job.stop, record=list(job.record)
        ).trace
        return {n: trace[n] for n in job.record} | {"time": trace.time}
    name = Path(job.path).stem
    scenario = None
    if job.input:
        variable, at, values = job.series()
        scenario = Trace(at, {f"{name}.{variable}": values})
    trace = run(
        load(job.path),
        scenario,
        step=job.step,
        stop=job.stop,
        tolerance=1e-9,
        record=[f"{name}.{n}" for n in job.record],
    ).trace
    return {n: trace[f"{name}.{n}"] for n in job.record} | {"time": trace.time}


if __name__ == "__main__":
    os.chdir(Path(sys.argv[1]).parent)
    main()
