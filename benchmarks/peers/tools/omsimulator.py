"""OMSimulator by its Python package: its weakly coupled master with a fixed step, results to a MAT file.

It writes the signals of all FMUs unless they are taken out, and always computes them.
"""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from lxml import etree
from OMSimulator import OMSimulator
from scipy.io import loadmat

from benchmarks.peers.ssp import structure
from benchmarks.peers.tools import Run, Spent, nothing


def run(system: Path, stop: float, record: Sequence[str], judged: Sequence[str], step: float) -> Run:
    """One run."""
    steps = round(stop / step)
    tool = OMSimulator()
    tool.setLoggingLevel(0)
    # the tool changes the working directory of the process
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        _checked(tool.setTempDirectory(folder))
        tool.setLogFile(f"{folder}/log.txt")
        model, status = tool.importFile(str(system))
        _checked(status)
        try:
            root = f"{model}.{_root(system)}"
            file = Path(folder) / "run.mat"
            _prepare(tool, model, root, record, file, stop, step)
            begin = Spent.until_now()
            done = tool.simulate(model)
            spent = Spent.until_now() - begin
            _checked(done)
            tool.terminate(model)
        finally:
            tool.delete(model)
        return _read(file, root, judged, spent, steps) if record else nothing(spent, steps)


def _root(system: Path) -> str:
    return str(etree.fromstring(structure(system)).find("{*}System").attrib["name"])


def _prepare(
    tool: OMSimulator, model: str, root: str, record: Sequence[str], file: Path, stop: float, step: float
) -> None:
    _checked(tool.setStopTime(model, stop))
    _checked(tool.setResultFile(model, str(file) if record else ""))
    _checked(tool.setSolver(root, tool.solver_wc_ma))
    _checked(tool.setFixedStepSize(root, step))
    _checked(tool.setLoggingInterval(model, 0.0))
    _checked(tool.instantiate(model))
    _checked(tool.removeSignalsFromResults(model, ".*"))
    for signal in record:
        _checked(tool.addSignalsToResults(model, re.escape(f"{root}.{signal}")))
    _checked(tool.initialize(model))


def _read(file: Path, root: str, judged: Sequence[str], spent: Spent, steps: int) -> Run:
    """A trajectory file in the format of Dymola: names, their columns, and the values."""
    content = loadmat(file, chars_as_strings=False)
    names = ["".join(characters).strip("\0 ") for characters in content["name"].T]
    columns = dict(zip(names, content["dataInfo"].T[:, 1], strict=True))
    data = content["data_2"]

    def row(name: str) -> np.ndarray:
        number = int(columns[name])
        return np.sign(number) * data[abs(number) - 1]

    return Run(spent, steps, data[0], {n: row(f"{root}.{n}") for n in judged})


def _checked(status: int) -> None:
    if status not in (0, 1):
        raise RuntimeError(f"OMSimulator: status {status}")
