"""On a cluster of Dask: the same content as here, byte by byte, also when one of its processes dies."""

import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import Mock

import dask
import numpy as np
import psutil
import pytest
from distributed import Client, LocalCluster
from distributed.utils import LoopRunner, json_load_robust
from kit import shards
from kit.mistakes import problem
from kit.needs import needs
from kit.wait import LONG, until
from sweep.studies import FAILS, GAIN, content, run, study

from orchestrator import Problem, batch
from orchestrator.lanes import cluster
from orchestrator.lanes.cluster import BATCH_TIME, LARGE, Packing
from orchestrator.studies import Factor, Output, Study
from orchestrator.studies.parameter_study import sweep
from orchestrator.studies.runs import StudyRuns

RUNS = 240  # in many batches
MANY = GAIN.replace("runs = 12", f"runs = {RUNS}").replace("stop = 0.2", "stop = 20")
HERE = tuple(cluster.installation())


# ---- a cluster in this process


@pytest.fixture(scope="module")
def inside() -> Iterator[Client]:
    """A client of a scheduler and a worker in threads of this process."""
    options = {"processes": False, "threads_per_worker": 2, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(1, **options, silence_logs=50) as there, Client(there) as client:
        yield client


def listening() -> set[object]:
    """Addresses at which this process listens: a server of another test may still be ending."""
    return {c.laddr for c in psutil.Process().net_connections() if c.status == psutil.CONN_LISTEN}


def test_no_port_is_opened_on_this_machine(file, tmp_path):
    """A study without a cluster listens on no port, and does not import Dask."""
    before, during = listening(), set()
    sweep(file, tmp_path / "out", watch=lambda *_: during.update(listening()))
    assert during <= before
    code = "import sys, orchestrator.studies.parameter_study; sys.exit('distributed' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_cluster_gives_the_content_of_this_computer(file, tmp_path, inside):
    """Byte by byte, each run once."""
    run(file, "here")
    seen = []
    sweep(file, tmp_path / "there", client=inside, watch=lambda _total, _done, new: seen.extend(new))
    assert content(tmp_path / "there") == content(tmp_path / "here")
    assert sorted(outcome.run for outcome in seen) == list(range(12))


def test_foreign_fmus_that_crash_are_told_as_here(fmus, tmp_path, inside):
    """A crash ends its run only, with the same reason; the worker goes on."""
    file = study(tmp_path, FAILS, fmus["fails"])
    assert set(run(file, "here")[0].table["status"]) == {"ok", "failed", "early"}
    sweep(file, tmp_path / "there", client=inside)
    assert content(tmp_path / "there") == content(tmp_path / "here")


def test_nothing_is_left_on_the_workers(file, tmp_path, inside):
    """Neither the plugin of the study nor a process; only the contents stay, for the next one."""
    before = {p.pid for p in psutil.Process().children()}
    sweep(file, tmp_path / "out", client=inside)
    (plugins,) = inside.run(lambda dask_worker: [*dask_worker.plugins]).values()
    assert not [name for name in plugins if name.startswith("harvester-cosim")]
    assert {p.pid for p in psutil.Process().children()} <= before


class Sums:
    """Runs that add a number to the length of some bytes; `lost` says why not."""

    compiled = False

    def __init__(self, content: bytes) -> None:
        self._content = content
        self.close = self.stop = lambda: None

    def __reduce__(self):
        return type(self), (self._content,)

    def run(self, task: int) -> int:
        """The sum; a task below zero fails."""
        if task < 0:
            raise OSError("the disk is full")
        return task + len(self._content)

    def lost(self, task: int, reason: str) -> str:
        """The reason, with the number of the task."""
        return f"{task}: {reason}"


def test_contents_travel_once(inside, monkeypatch):
    """To a worker that has them from an earlier study nothing is sent, and small ones go with the rest."""
    sent, run_there = [], inside.run

    def noted(function, *arguments, **options):
        if function is cluster.enter:
            sent.append([*map(len, arguments[2].values())])
        return run_there(function, *arguments, **options)

    monkeypatch.setattr(inside, "run", noted)
    content = os.urandom(LARGE)
    for given in (content, content, content[1:]):
        found = []
        cluster.many(Sums(given), range(5), found.extend, inside, 0.0)
        assert sorted(found) == [len(given) + n for n in range(5)]
    assert sent == [[LARGE], [], []]


def test_an_error_of_a_worker_ends_all_and_keeps_what_is_done(inside):
    """The line names the worker; outcomes of the same batch are kept."""
    kept = []
    line = problem(lambda: cluster.many(Sums(b""), [1, 2, 3, -1], kept.extend, inside, 0.0))
    (address,) = inside.nthreads()
    assert line == f"worker {address}: OSError: the disk is full"
    assert set(kept) <= {1, 2, 3}


# ---- the workers


@pytest.mark.parametrize("part", range(3))
def test_another_installation_is_refused_before_the_first_run(part, monkeypatch, inside):
    """Version, Python or code: a line with the worker, what is here and what is there."""
    other = (*HERE[:part], "other", *HERE[part + 1 :])
    monkeypatch.setattr(Client, "run", lambda *_, **__: {"tcp://there": (other, ())})
    line = problem(lambda: cluster.many(Sums(b""), [1], Mock(), inside, 0.0))
    names = "harvester-cosim {}, Python {}, code {}"
    here, there = names.format(*HERE), names.format(*other)
    assert line == f"worker tcp://there: expected {here}, found {there}"


def test_a_compiler_matters_only_in_lanes(monkeypatch, inside):
    """Of lanes, other compilers would make other code."""
    other = (*HERE[:3], "")
    found = Mock(return_value={"tcp://there": (other, ())})
    monkeypatch.setattr(Client, "run", found)
    runs = Sums(b"")
    workers = cluster.Workers(inside, runs)
    assert workers._expected == HERE[:3]
    monkeypatch.setattr(Sums, "compiled", True)
    line = problem(lambda: cluster.many(runs, [1], Mock(), inside, 0.0))
    assert line.endswith(f"ziglang {HERE[3]}, found {line.partition('found ')[2]}")
    assert line.endswith("ziglang not installed")


def test_a_cluster_that_is_lost_for_good_is_told(monkeypatch):
    """The command does not wait for ever."""
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 0.0)
    deserted = cluster.Workers(Mock(**{"nthreads.return_value": {}}), Sums(b""))
    problem(deserted.threads, r"^the Dask cluster has no workers left$")


# ---- batches


def test_batches_have_about_the_same_work():
    """One task until one is measured; then BATCH_TIME of work, however long a task takes, at least one."""
    packing = Packing()
    assert packing.size(1000, 4) == 1
    for task in (0.01, 0.5, 3.0, 1e-5):
        for _ in range(30):
            packing.measured(10, 10 * task)
        # the mean of the last batches is nearly that of the last tasks
        assert packing.size(10**12, 4) == pytest.approx(max(BATCH_TIME / task, 1), abs=1, rel=1e-3)
        # 1000 workers with 10 s in each batch end 100 batches per second
        assert packing.size(10**12, 2000) == pytest.approx(max(10 / task, 1), abs=1, rel=1e-3)


def test_the_last_batches_are_equal_shares():
    """So that no worker is at a long batch while others have nothing; all tasks are handed out."""
    packing, waiting, sizes = Packing(), 1000, []
    packing.measured(1, 0.01)
    while waiting:
        sizes.append(packing.size(waiting, 4))
        waiting -= sizes[-1]
    assert waiting == 0
    assert sizes[0] == 150
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-4:] == [1] * 4


# ---- the other ways to many runs


def test_a_batch_of_foreign_fmus(gain, inside):
    """Bit for bit as here: values, status, reasons."""
    values = {"gain.factor": np.linspace(1.0, 2.0, 5), "gain.u": np.linspace(0.0, 1.0, 5)}
    here, there = (batch(gain, values, stop=0.1, step=0.01, client=c) for c in (None, inside))
    assert [*here] == [*there]
    assert all(np.array_equal(here[name], there[name]) for name in here)
    assert there.status.tolist() == here.status.tolist() == ["ok"] * 5
    problem(lambda: batch(gain, values, stop=0.1, client=inside, workers=2), "batch: workers: expected none")


def test_a_batch_whose_cluster_is_lost_keeps_what_is_done(gain, inside, monkeypatch):
    """The others have failed, and say why."""
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 0.0)
    monkeypatch.setattr(Client, "nthreads", lambda _: {})
    lost = batch(gain, {"gain.factor": [1.0, 2.0]}, stop=0.1, step=0.01, client=inside)
    assert lost.status.tolist() == ["failed"] * 2
    assert lost.reasons == ["the Dask cluster has no workers left"] * 2


MASS = Factor("manipulator.head_mass", "uniform", {"minimum": 300, "maximum": 900})
PEAK = Output("peak", "swing.swing_pressure_a", "maximum", band=True)


@shards.machine
@pytest.mark.parametrize("compiler", [True, False])
def test_lanes_of_a_study(compiler, built, tmp_path, inside, monkeypatch):
    """Byte by byte as here; if a worker lacks the compiler, as here without one: in processes."""
    plan = Study("Mass", str(built / "harvester.ssp"), runs=20, stop=0.2, factors=(MASS,), outputs=(PEAK,))
    units, together = StudyRuns.units, list[int]()

    def noted(self, samples, lanes=True):
        found = units(self, samples, lanes and compiler)
        together.extend(map(len, found))
        return found

    monkeypatch.setattr(StudyRuns, "units", noted)
    sweep(plan, tmp_path / "here")
    monkeypatch.setattr(cluster, "installation", lambda: (*HERE[:3], HERE[3] if compiler else ""))
    monkeypatch.setattr(StudyRuns, "units", units)
    sweep(plan, tmp_path / "there", client=inside)
    assert together == ([8, 8, 4] if compiler else [1] * 20)
    assert content(tmp_path / "there") == content(tmp_path / "here")


@pytest.mark.parametrize("lanes", [True, pytest.param(False, marks=shards.machine)])
def test_a_batch_of_the_machine(lanes, built, inside):
    """In lanes the workers compile, alone they have processes: bit for bit as here."""
    values, record = {"manipulator.head_mass": np.linspace(300, 400, 10)}, ["swing.swing_pressure_a"]
    options = {"stop": 0.1, "record": record, "lanes": lanes}
    here, there = (batch(built / "harvester.ssp", values, client=c, **options) for c in (None, inside))
    assert np.array_equal(here[record[0]], there[record[0]])
    assert here.reasons == there.reasons


# ---- a connection


def test_schedulers_that_are_not_there_leave_nothing_that_can_hang(monkeypatch):
    """Two hundred in one process, and the garbage collector always runs while Dask's lock is held.

    A client that is left half made is closed by the collector then, and waits for that lock for ever.
    """
    start, collected = LoopRunner._start_unlocked, []

    def with_garbage(runner: LoopRunner) -> None:
        collected.append(gc.collect())
        start(runner)

    monkeypatch.setattr(LoopRunner, "_start_unlocked", with_garbage)
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.02)
    threads = threading.active_count()
    gc.freeze()  # what is there already need not be looked at 200 times
    for n in range(200):
        url = ("nowhere", "foo://127.0.0.1:1", "tcp://127.0.0.1:1")[n % 3]
        expected = rf"^--scheduler {url}: expected a Dask scheduler, got [^\n]+$"
        with pytest.raises(Problem, match=expected), cluster.client(url):
            pass
    gc.unfreeze()
    assert len(collected) == 200
    assert threading.active_count() <= threads


@pytest.mark.parametrize("kept", [False, True])
def test_a_wrong_address_leaves_nothing_and_deletes_nothing(kept, gain, tmp_path, monkeypatch):
    """No folder where there was none, also none above it; with --fresh what is there stays, to be read."""
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
    file, out, url = study(tmp_path, GAIN, gain), tmp_path / "deep" / "out", "tcp://127.0.0.1:1"
    before = content(out) if kept and run(file, "deep/out") else {}
    line = problem(lambda: sweep(file, out, scheduler=url, fresh=kept))
    assert line.startswith(f"--scheduler {url}: expected a Dask scheduler")
    assert (tmp_path / "deep").exists() is kept
    assert content(out) == before
    assert bool(before) is kept
    if kept:  # a finished study needs no scheduler
        assert len(sweep(file, out, scheduler=url).table) == 12


# ---- scheduler and workers for real, in processes of their own


class Cluster:
    """A scheduler and workers on the loopback address, until the end of a block.

    The scheduler allows one repetition of what a dead worker has done, in place of three.
    """

    def __init__(self, folder: Path, *options: str, **settings: str) -> None:
        self._folder, self._stack, self._options, self._settings = folder, ExitStack(), options, settings

    def __enter__(self) -> "Cluster":
        file = self._folder / "scheduler.json"
        options = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file), *self._options)
        self.scheduler = self.start(f"{DASK.format('scheduler')}", *options)
        self.address = json_load_robust(file, timeout=LONG)["address"]
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def start(self, code: str, *arguments: str) -> subprocess.Popen[bytes]:
        """A program of Dask."""
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        python = {"cwd": self._folder, "env": {**os.environ, **SETTINGS, **self._settings}}
        own_port = ("--dashboard-address", "127.0.0.1:0")
        command = [sys.executable, "-c", code, *arguments, *own_port]
        process = self._stack.enter_context(subprocess.Popen(command, **quiet, **python))
        self._stack.callback(process.kill)
        return process

    def worker(self, before: str = "", nanny: bool = False) -> subprocess.Popen[bytes]:
        """A worker with one thread; before: code that it runs first."""
        options = ("--host", "127.0.0.1", "--nthreads", "1", "--nanny" if nanny else "--no-nanny")
        return self.start(before + DASK.format("worker"), self.address, *options, *self._options)

    def wait(self, workers: int) -> None:
        """Until so many have joined."""
        with Client(self.address, timeout=LONG) as client:
            client.wait_for_workers(workers, timeout=LONG)

    def there(self) -> int:
        """How many workers there are."""
        with Client(self.address, timeout=LONG) as client:
            return len(client.nthreads())


SETTINGS = {
    "PYTHONPATH": str(Path(__file__).parents[1]),
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
}
DASK = "from distributed.cli.dask_{} import main; main()"
ROLES = ("scheduler", "worker", "client")
WITHOUT_PACKAGE = "import sys; sys.modules['orchestrator'] = None; "


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler without workers."""
    with Cluster(tmp_path) as there:
        yield there


@shards.faults
def test_workers_die_and_join(gain, processes, tmp_path):
    """One of two is killed in the middle, one joins, and one without the package is sent away.

    No run is lost or there twice, and the content is that of an undisturbed study, byte by byte.

        python -m pytest -m long tests/sweep/test_cluster.py -k die_and_join
    """
    file = study(tmp_path, MANY, gain)
    run(file, "here")
    workers, seen = [processes.worker(), processes.worker()], list[int]()
    processes.wait(2)

    def watch(_total, done, new):
        """When the first batch is done."""
        seen.extend(outcome.run for outcome in new)
        if new and len(workers) == 2:
            workers[0].kill()
            workers.extend([processes.worker(), processes.worker(WITHOUT_PACKAGE)])
            processes.wait(2)
            assert done < RUNS

    result = sweep(file, tmp_path / "there", scheduler=processes.address, watch=watch)
    assert sorted(seen) == sorted(result.table["run"]) == list(range(RUNS))
    assert content(tmp_path / "there") == content(tmp_path / "here")


class Deadly(Sums):
    """Runs whose third task ends the process of the worker."""

    def run(self, task: int) -> int:
        """As `Sums`."""
        if task == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().run(task)


@shards.faults
def test_a_task_that_kills_its_workers_is_told_and_the_others_are_done(processes):
    """After the repetitions that the scheduler allows, `lost` says so; no other task is lost or there twice.

    Those that wait on the same worker die with it as often.
    """
    assert dask.config.get("distributed.scheduler.allowed-failures") == 3
    processes.worker(nanny=True)
    found = []
    with Client(processes.address, timeout=LONG) as client:
        client.wait_for_workers(1, timeout=LONG)
        cluster.many(Deadly(b""), range(12), found.extend, client, 0.0)
    assert sorted(map(str, found)) == sorted(
        ["3: the Dask worker died 2 times", *(str(n) for n in range(12) if n != 3)]
    )


@shards.faults
def test_a_late_worker_without_the_package_is_sent_away(gain, processes, tmp_path, caplog):
    """With a line in the log; the study goes on with the others."""
    processes.worker()
    processes.wait(1)
    file, late = study(tmp_path, MANY, gain), []

    def watch(_total, _done, new):
        if new and not late:
            late.append(processes.worker(WITHOUT_PACKAGE))
            assert until(lambda: processes.there() == 2)

    table = sweep(file, tmp_path / "there", scheduler=processes.address, watch=watch).table
    assert set(table["status"]) == {"ok"}
    late[0].wait(LONG)
    (line,) = [r.message for r in caplog.records if r.name == "orchestrator.lanes.cluster"]
    assert line.startswith("worker tcp://127.0.0.1:")
    assert "No module named 'orchestrator" in line or "import of orchestrator halted" in line
    assert line.endswith("; it is sent away")


@shards.faults
def test_a_worker_that_leaves_hands_its_runs_back(gain, processes, tmp_path):
    """A worker that is ended in an orderly way interrupts its runs; they are run by another one."""
    file = study(tmp_path, MANY, gain)
    run(file, "here")
    leaving = processes.worker()
    processes.worker()
    processes.wait(2)
    sweep(
        file,
        tmp_path / "there",
        scheduler=processes.address,
        watch=lambda _total, _done, new: leaving.terminate() if new else None,
    )
    assert content(tmp_path / "there") == content(tmp_path / "here")


# the command line, which does something when its first batch is kept: in the middle, however slow or fast
# this computer is
COMMAND = """
import os, signal, sys
from orchestrator.__main__ import main
from orchestrator.studies.store import Store
process, number, add = int(sys.argv.pop(1)), int(sys.argv.pop(1)), Store.add
def first(self, rows):
    add(self, rows)
    Store.add = add
    os.kill(process or os.getpid(), number)
Store.add = first
sys.exit(main())
"""
LOST = "harvester: the connection to the Dask scheduler is lost; "


@shards.faults
@pytest.mark.parametrize(("number", "told", "status"), [(9, LOST, 2), (2, "harvester: interrupted; ", 130)])
def test_an_end_is_told_in_one_line(number, told, status, gain, processes, tmp_path) -> None:
    """The scheduler is killed, or the command interrupted: no log of Dask, no traceback.

    What was finished is kept, the study goes on, and nothing runs on the cluster.
    """
    processes.worker()
    processes.wait(1)
    file, out = study(tmp_path, MANY, gain), tmp_path / "out"
    options = ["sweep", str(file), "--out", str(out), "--scheduler", processes.address]
    process = str(processes.scheduler.pid if number == 9 else 0)
    command = [sys.executable, "-c", COMMAND, process, str(number), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    *progress, last = done.stderr.splitlines()
    assert last.startswith(told), done.stderr
    assert last.endswith(f" of {RUNS} runs are stored in {out}; the same command continues the study")
    assert all(f" of {RUNS} runs" in line for line in progress), done.stderr
    assert (done.stdout, done.returncode) == ("", status)
    if number == 2:
        with Client(processes.address, timeout=LONG) as client:
            (left,) = client.run(
                lambda dask_worker: [*dask_worker.plugins, *dask_worker.state.tasks]
            ).values()
        assert not [name for name in left if "harvester" in name or "load" in name]
    _, fresh = run(file)
    assert 0 < len(fresh) < RUNS
    run(file, "undisturbed")
    assert content(out) == content(tmp_path / "undisturbed")


@needs("openssl")
@shards.faults
def test_the_tls_settings_of_dask_are_used(file, tmp_path):
    """With certificates of one's own a study runs over tls://, and without them nobody gets in."""
    key, cert = tmp_path / "key.pem", tmp_path / "cert.pem"
    make = f"openssl req -x509 -newkey rsa:2048 -nodes -keyout {key} -out {cert} -days 2 -subj /CN=study"
    subprocess.run(make.split(), check=True, capture_output=True)
    tls = {"distributed.comm.tls.ca-file": str(cert), "distributed.comm.require-encryption": True}
    for role in ROLES:
        tls |= {f"distributed.comm.tls.{role}.{n}": str(f) for n, f in (("cert", cert), ("key", key))}
    settings = {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": str(cert)}
    for role in ROLES:
        settings[f"DASK_DISTRIBUTED__COMM__TLS__{role.upper()}__CERT"] = str(cert)
        settings[f"DASK_DISTRIBUTED__COMM__TLS__{role.upper()}__KEY"] = str(key)
    with Cluster(tmp_path, "--protocol", "tls", **settings) as there:
        assert there.address.startswith("tls://")
        line = problem(lambda: sweep(file, tmp_path / "out", scheduler=there.address))
        assert line.startswith(f"--scheduler {there.address}: expected a Dask scheduler, got TLS")
        with dask.config.set(tls):
            there.worker()
            there.wait(1)
            assert set(sweep(file, tmp_path / "out", scheduler=there.address).table["status"]) == {"ok"}
