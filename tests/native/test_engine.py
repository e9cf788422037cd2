"""Garbage from FMUs: the C code of a run, and its events, clocks and arrays, under sanitizers."""

import json
import os
import sys
from pathlib import Path

from kit import shards
from kit.any_fmu.description import member, packed
from native.bench import CODE, needs_gcc, run
from native.test_garbage import SANITIZED, SEED

from fmus.export.compile import HEADERS
from orchestrator.engine.c_library import FOLDER

RUNS = int(os.environ.get("NATIVE_FUZZ_RUNS", "300"))
FLAGS = ("-std=gnu11", "-D_GNU_SOURCE", "-fPIC", "-shared", "-pthread", "-isystem", str(HEADERS))
ABLE = 'modelIdentifier="chaos" canGetAndSetFMUState="true"'
EVENTS = 'hasEventMode="true" mightReturnEarlyFromDoStep="true" canHandleVariableCommunicationStepSize="true"'
CLOCKED = """<Clock name="tick" valueReference="8" causality="input" intervalVariability="{}"{}/>
<Clock name="fired" valueReference="9" causality="output" intervalVariability="triggered"/>
<Clock name="come" valueReference="10" causality="input" intervalVariability="triggered"/>
<Int32 name="count" valueReference="11" causality="output" clocks="8"/>
<String name="text" valueReference="12" causality="output" clocks="9"/>
<String name="word" valueReference="13" causality="input" clocks="10"><Start value=""/></String>"""
CLOCKED_OUTPUTS = "".join(f'<Output valueReference="{n}" dependencies=""/>' for n in (9, 11, 12))
STATES = """<Float64 name="x" valueReference="14" causality="local" initial="exact" start="1">
<Dimension start="2"/></Float64>
<Float64 name="der(x)" valueReference="15" causality="local" derivative="14"><Dimension start="2"/></Float64>
<Float64 name="z" valueReference="16" causality="local"><Dimension start="2"/></Float64>"""
RATES = '<ContinuousStateDerivative valueReference="15"/><EventIndicator valueReference="16"/>'


def fmus(library: Path, folder: Path) -> None:
    """The FMU of chaos.c for Co-Simulation with a clock of each kind, and for Model Exchange."""
    text = (CODE / "chaos.xml").read_text("utf-8")
    kinds = {"fixed": ' intervalDecimal="0.07"', "tunable": "", "changing": "", "countdown": ""}
    made = {
        kind: (f"<CoSimulation {ABLE} {EVENTS}/>", CLOCKED.format(kind, interval), CLOCKED_OUTPUTS)
        for kind, interval in kinds.items()
    }
    made["exchange"] = (f'<ModelExchange {ABLE} needsCompletedIntegratorStep="true"/>', STATES, RATES)
    for name, parts in made.items():
        description = text
        for place, part in zip(("KIND", "MORE", "STRUCTURE"), parts, strict=True):
            description = description.replace(place, part)
        members = {"modelDescription.xml": description, member(3, "chaos"): library.read_bytes()}
        packed(folder / f"{name}.fmu", members)


@needs_gcc
@shards.c
def test_no_answer_of_an_fmu_breaks_the_engine(tmp_path: Path) -> None:
    """Runs of random systems end, complete or with one line; no sanitizer finds anything in them.

    Events at any time, early returns, time events in the past, clocks with any interval, arrays, numbers that
    are not finite, calls that fail, and steps that are never the same when they are repeated.
    """
    engine, chaos = tmp_path / "engine.so", tmp_path / "chaos.so"
    run([*SANITIZED, *FLAGS, *sorted(FOLDER.glob("*.c")), "-o", engine, "-lm"])
    run([*SANITIZED, *FLAGS, "-Wall", "-Wextra", CODE / "chaos.c", "-o", chaos, "-lm"])
    fmus(chaos, tmp_path)
    names = ("libasan.so", "libubsan.so")
    preloaded = [run(["gcc", f"-print-file-name={name}"]).stdout.strip() for name in names]
    environment = {**os.environ, "LD_PRELOAD": " ".join(preloaded), "ASAN_OPTIONS": "detect_leaks=0"}
    command = [sys.executable, Path(__file__).with_name("chaos.py"), engine, tmp_path, SEED, RUNS]
    found = json.loads(run(command, env=environment).stdout.splitlines()[-1])
    assert sum(found.values()) == RUNS
    assert min(found["complete"], found["ended"]) > RUNS / 10  # it gets somewhere, and it is garbage
