"""Benchmark of a study on a Dask cluster of this computer, against processes of this computer.

    python -m benchmarks.cluster [--runs 5000] [--seconds 2] [--rounds 4] [--lanes]
    python -m benchmarks.cluster --batches 3000     of empty tasks, one in each batch: what a batch costs

The study varies the swing FMU, each run in a child process; with --lanes the whole machine, in lanes where
there is a compiler. A scheduler and two workers with one thread each are started on the loopback address. In
each round the same runs take place here, by two processes, and there, in turn, from opening the runs to the
last outcome. Printed are

    throughput   runs per second of all rounds, and its ratio, there over here
    processor    time of the scheduler and of this process (the client) per run, and of both for a batch
    messages     that scheduler, client and workers have sent, and their bytes, per run

Limit: the ratio is at least RATIO; below it the exit status is 1. Ratios need no idle computer, because both
have the same load in turn, but one that does nothing else gives them with less scatter.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import psutil
from distributed import Client
from distributed.comm.tcp import TCP

from orchestrator.lanes import cluster
from orchestrator.lanes.many import many
from orchestrator.studies import Factor, Output, Study
from orchestrator.studies.runs import STORE_TIME, StudyRuns, prepare

RATIO, WORKERS = 0.9, 2
SENT = [0, 0]  # messages and bytes that this process has sent


def study(runs: int, seconds: float, lanes: bool) -> Study:
    """One factor, two outputs."""
    if lanes:
        mass = Factor("manipulator.head_mass", "uniform", {"minimum": 300, "maximum": 400})
        peak = Output("peak", "swing.swing_pressure_a", "maximum")
        return Study("Mass", "build/harvester.ssp", runs=runs, stop=seconds, factors=(mass,), outputs=(peak,))
    command = Factor("swing.swing_command", "uniform", {"minimum": -5, "maximum": 5})
    outputs = (Output("a", "swing.swing_pressure_a", "maximum"), Output("b", "swing.swing_torque", "final"))
    return Study(
        "Swing", "build/swing.fmu", runs=runs, stop=seconds, step=1e-3, factors=(command,), outputs=outputs
    )


def count() -> None:
    """Count what this process sends from now on."""
    write = TCP.write

    async def counted(self: Any, *arguments: Any, **options: Any) -> int:
        size: int = await write(self, *arguments, **options)
        SENT[0] += 1
        SENT[1] += size
        return size

    TCP.write = counted


def sent() -> list[int]:
    """What this process has sent."""
    return SENT


class Empty:
    """Tasks without work."""

    compiled = False

    def run(self, task: int) -> int:
        """Nothing."""
        return task

    def lost(self, task: int, reason: str) -> int:
        """Never called."""
        raise AssertionError(f"{task}: {reason}")

    def stop(self) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


def empty_batches(count: int) -> None:
    """Print what batches without work cost."""
    from benchmarks.cluster import Empty  # by its name, as workers import it

    with on_loopback() as (client, scheduler):
        here = psutil.Process()
        many(Empty(), range(10), lambda _: None, client)
        cluster.BATCH_TIME = 0.0  # one task in each

        def used() -> list[float]:
            return [sum(p.cpu_times()[:2]) for p in (scheduler, here)]

        at_rest = used()
        time.sleep(10.0)
        at_rest = [(after - before) / 10.0 for before, after in zip(at_rest, used(), strict=True)]
        began, before = time.perf_counter(), used()
        many(Empty(), range(count), lambda _: None, client)
        wall = time.perf_counter() - began
        print(f"{count} empty batches in {wall:.1f} s: {count / wall:.0f} per second")
        for name, rest, a, b in zip(("scheduler", "client"), at_rest, before, used(), strict=True):
            batch = (b - a - rest * wall) / count
            print(
                f"processor time of the {name}: {1e3 * batch:.2f} ms per batch, {1e3 * rest:.1f} ms/s at rest"
            )


@contextmanager
def on_loopback() -> Iterator[tuple[Client, psutil.Process]]:
    """A client of a scheduler with workers, and the process of the scheduler."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))

        def start(program: str, *arguments: str) -> subprocess.Popen[bytes]:
            arguments += ("--dashboard-address", "127.0.0.1:0")
            command = [sys.executable, "-m", f"distributed.cli.dask_{program}", *arguments]
            log = stack.enter_context((folder / f"{program}.log").open("a"))
            process = subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, "PYTHONPATH": "."})
            stack.callback(process.wait)
            stack.callback(process.terminate)
            return process

        file = folder / "scheduler.json"
        options = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        scheduler = start("scheduler", *options)
        workers = ("--nworkers", str(WORKERS), "--nthreads", "1", "--host", "127.0.0.1")
        start("worker", "--scheduler-file", str(file), *workers, "--local-directory", str(folder))
        while not file.exists():
            time.sleep(0.1)
        client = stack.enter_context(Client(scheduler_file=str(file), timeout=60))
        client.wait_for_workers(WORKERS, timeout=60)
        yield client, psutil.Process(scheduler.pid)


def timed(prepared: Any, units: Sequence[Any], where: Any) -> float:
    """Wall time [s] of some runs, which must all succeed."""
    began, outcomes = time.perf_counter(), list[Any]()
    with closing(StudyRuns(prepared)) as runs:
        in_lanes = any(len(unit) > 1 for unit in units)
        if in_lanes:
            runs.units(prepared.samples)  # opens the lanes
        many(runs, units, lambda found: outcomes.extend(o for f in found for o in f), where, STORE_TIME)
    wall = time.perf_counter() - began
    assert len(outcomes) == sum(map(len, units))
    assert all(outcome.status == "ok" for outcome in outcomes), outcomes[0]
    return wall


def main() -> int:
    """Print the figures; exit status 1 if the ratio is too small."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=5000)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--lanes", action="store_true")
    parser.add_argument("--batches", type=int)
    given = parser.parse_args()
    if given.batches:
        empty_batches(given.batches)
        return 0
    prepared = prepare(study(given.runs, given.seconds, given.lanes))
    with closing(StudyRuns(prepared)) as runs:
        units = runs.units(prepared.samples, given.lanes)
    here = there = 0.0
    processor, messages, size, batches = [0.0, 0.0], 0, 0, 0
    with on_loopback() as (client, scheduler):
        count()
        client.run(count)
        client.run_on_scheduler(count)
        submit = client.submit

        def submitted(*arguments: Any, **options: Any) -> Any:
            nonlocal batches
            batches += 1
            return submit(*arguments, **options)

        client.submit = submitted

        def total() -> tuple[int, int]:
            counts = [*client.run(sent).values(), client.run_on_scheduler(sent), SENT]
            return sum(c[0] for c in counts), sum(c[1] for c in counts)

        def used() -> list[float]:
            return [sum(p.cpu_times()[:2]) for p in (scheduler, psutil.Process())]

        first = timed(prepared, units[:WORKERS], WORKERS), timed(prepared, units[:WORKERS], client)
        print(
            f"first {WORKERS} tasks, with imports: here {first[0]:.2f} s, there {first[1]:.2f} s", flush=True
        )
        batches = 0
        for n in range(given.rounds):
            some = units[n :: given.rounds]
            here_now = timed(prepared, some, WORKERS)
            before, sent_before = used(), total()
            there_now = timed(prepared, some, client)
            after, sent_after = used(), total()
            processor = [p + b - a for p, a, b in zip(processor, before, after, strict=True)]
            messages += sent_after[0] - sent_before[0]
            size += sent_after[1] - sent_before[1]
            here, there = here + here_now, there + there_now
            print(f"round {n + 1}: here {here_now:.2f} s, there {there_now:.2f} s", flush=True)
    runs_ = given.runs
    print(f"{runs_} runs of {given.seconds:g} s: {len(units)} tasks, {batches} batches")
    print(f"throughput: here {runs_ / here:.1f} runs/s, there {runs_ / there:.1f} runs/s")
    for name, seconds in zip(("scheduler", "client"), processor, strict=True):
        per = f"{1e3 * seconds / runs_:.3f} ms per run, {1e3 * seconds / batches:.1f} ms per batch"
        print(f"processor time of the {name}: {per}")
    per = f"{messages / runs_:.2f} messages and {size / runs_:.0f} bytes per run"
    print(f"sent: {per}; {messages / batches:.1f} messages and {size / batches:.0f} bytes per batch")
    code = sum(map(len, prepared.archives.values()))
    print(f"FMUs: {code} bytes, once per worker; {cluster.BATCH_TIME:g} s of work in a batch")
    print(f"ratio: {here / there:.3f} (limit: {RATIO})")
    return int(here / there < RATIO)


if __name__ == "__main__":
    sys.exit(main())
