"""A plugin of pytest: where the time of a run goes; `--seconds` fails if a file takes too much of it.

A file may take `MOST` times the mean of all files of the run. So the limit does not depend on the computer.
Nor does the ratio of all worker-seconds to a loop of Python, by which commits are compared.
"""

import time
from collections import Counter
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import pytest

MOST = 15.0  # times the mean file: 4 % of a run of 375 files
LEAST = 1.0  # s that any file may take, for runs of a few quick ones

LOOP = 3_000_000  # numbers whose squares are added
loops: list[float] = []  # s that this took before and after the run

building = 0.0  # s that the test which runs has built the machine, or waited for the process that does


def pytest_addoption(parser: pytest.Parser) -> None:
    """`make test` asks for it."""
    parser.addoption("--seconds", action="store_true", help="seconds by folder; too slow a file is a failure")


def loop() -> float:
    """Seconds of a loop of Python."""
    begin = time.perf_counter()
    sum(i * i for i in range(LOOP))
    return time.perf_counter() - begin


def pytest_sessionstart(session: pytest.Session) -> None:
    """Before there are other test processes."""
    if session.config.getoption("--seconds") and not hasattr(session.config, "workerinput"):
        loops.append(loop())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    """The machine is built for all tests, not for the first that asks."""
    global building
    report = yield
    report.building, building = min(building, report.duration), 0.0
    return report


def seconds_of(reports: Any) -> Counter[str]:
    """Worker-seconds of each file, and of the machine's build under the name ""."""
    files = Counter[str]()
    for report in reports:
        if hasattr(report, "building"):  # not that of a worker that crashed
            files[report.nodeid.partition("::")[0]] += report.duration - report.building
            files[""] += report.building
    return files


def too_slow(files: Mapping[str, float]) -> dict[str, str]:
    """The files above the limit -> what is wrong, the slowest first."""
    seconds = {name: s for name, s in files.items() if name}
    limit = max(MOST * sum(seconds.values()) / max(len(seconds), 1), LEAST)
    slowest = sorted(seconds, key=seconds.__getitem__, reverse=True)
    expected = f"expected at most {limit:.0f} s, {MOST:g} times the mean file: share, shorten, shard"
    return {n: f"{n}: {seconds[n]:.0f} s, {expected}" for n in slowest if seconds[n] > limit}


def _of_run(config: pytest.Config) -> Counter[str]:
    reporter: Any = config.pluginmanager.get_plugin("terminalreporter")
    return seconds_of(report for reports in reporter.stats.values() for report in reports)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """A run that passed fails if a file takes too much of it."""
    main = session.config.getoption("--seconds") and not hasattr(session.config, "workerinput")
    if main and exitstatus == pytest.ExitCode.OK and too_slow(_of_run(session.config)):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Worker-seconds by folder, the slowest files, and those that are too slow."""
    if not config.getoption("--seconds"):
        return
    files = _of_run(config)
    folders = Counter({"the machine's build": files.pop("", 0.0)})
    for file, seconds in files.items():
        folders[str(Path(file).parent)] += seconds
    loops.append(loop())
    whole, each = sum(folders.values()), sum(loops) / len(loops)
    took = " s before and ".join(f"{seconds:.3f}" for seconds in loops)
    terminalreporter.section(f"{whole:.0f} worker-seconds")
    terminalreporter.line(f"{whole / each:.0f} times a loop of Python, which took {took} s after the run")
    for counted, most in ((folders, None), (files, 10)):
        terminalreporter.line("  ".join(f"{n} {s:.0f}" for n, s in counted.most_common(most)))
    for line in too_slow(files).values():
        terminalreporter.line(f"ERROR {line}", red=True)
