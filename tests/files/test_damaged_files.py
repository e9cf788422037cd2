"""Damaged and hostile FMUs and SSPs: one line or findings, in bounded time and memory, and nothing touched.

The damage follows from a seed, so a failure can be repeated: `examine` prints the seeds that fail.
"""

from __future__ import annotations

import io
import os
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from check.good import BUILD, DESCRIPTION, TERMINALS, XML_2, XML_3
from files.damage import damaged
from kit import shards
from kit.any_fmu.models import Workshop

from fmus.machine.ssp import VIEW
from orchestrator import load
from orchestrator.base.errors import Problem
from orchestrator.check import DEFECT, check
from orchestrator.check.ls_ref_comparison import cases
from orchestrator.check.read_ls_ref import FOLDER, manifest, parameter_set, table
from orchestrator.check.subject import open_subject
from orchestrator.scene.view_description import view_description
from orchestrator.ssp.dependencies import output_order
from orchestrator.ssp.listing import lines
from orchestrator.ssp.parameter_sets import parameter_sets, with_sets
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System

LONGEST = 10.0  # s for one file; a good one takes 0.1 s
MOST = 1e9  # bytes

OUTER = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="test"
 xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
 xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
 xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping">
<ssd:System name="top">
<ssd:Connectors><ssd:Connector name="command" kind="input"><ssc:Real unit="mm"/></ssd:Connector>
<ssd:Connector name="result" kind="output"><ssc:Real unit="m"/></ssd:Connector></ssd:Connectors>
<ssd:ParameterBindings><ssd:ParameterBinding source="resources/start.ssv"><ssd:ParameterMapping
 source="resources/names.ssm"/></ssd:ParameterBinding></ssd:ParameterBindings>
<ssd:Elements>
<ssd:Component name="a" source="resources/gain.fmu"><ssd:Connectors>
<ssd:Connector name="u" kind="input"/><ssd:Connector name="y" kind="output"/></ssd:Connectors>
<ssd:ParameterBindings><ssd:ParameterBinding prefix=""><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="p"><ssv:Parameters><ssv:Parameter name="factor"><ssv:Real value="3"/>
</ssv:Parameter></ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>
</ssd:ParameterBindings></ssd:Component>
<ssd:System name="inner"><ssd:Connectors><ssd:Connector name="demand" kind="input"/>
<ssd:Connector name="answer" kind="output"/></ssd:Connectors><ssd:Elements>
<ssd:Component name="b" source="resources/gain.fmu"/></ssd:Elements><ssd:Connections>
<ssd:Connection startConnector="demand" endElement="b" endConnector="u"><ssc:LinearTransformation factor="10"
 offset="1"/></ssd:Connection><ssd:Connection startElement="b" startConnector="y" endConnector="answer"/>
</ssd:Connections></ssd:System>
<ssd:Component name="c" type="application/x-ssp-definition" source="other.ssd"/>
<ssd:Component name="d" type="application/x-ssp-package" source="resources/inner.ssp"/>
</ssd:Elements><ssd:Connections>
<ssd:Connection startConnector="command" endElement="inner" endConnector="demand"/>
<ssd:Connection startElement="inner" startConnector="answer" endElement="a" endConnector="u"/>
<ssd:Connection startElement="a" startConnector="y" endConnector="result"/>
</ssd:Connections></ssd:System>
<ssd:Units><ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>
<ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit></ssd:Units>
<ssd:DefaultExperiment startTime="0" stopTime="1"><ssd:Annotations><ssc:Annotation type="harvester-cosim">
<hc:Coupling xmlns:hc="urn:harvester-cosim:coupling" master="gauss-seidel" step="0.01"><hc:Factor
 component="a" steps="2"/></hc:Coupling></ssc:Annotation></ssd:Annotations></ssd:DefaultExperiment>
</ssd:SystemStructureDescription>
"""
INNER = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="2.0" name="part"
 xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"><ssd:System name="part"><ssd:Elements>
<ssd:Component name="g" source="resources/gain.fmu"/></ssd:Elements></ssd:System>
</ssd:SystemStructureDescription>
"""
START = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet version="1.0" name="start" xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
<ssv:Parameters><ssv:Parameter name="strength"><ssv:Real value="4"/></ssv:Parameter>
<ssv:Parameter name="inner.b.factor"><ssv:Real value="5"/></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>
"""
MAPPING = """<?xml version="1.0" encoding="UTF-8"?>
<ssm:ParameterMapping version="1.0" xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping">
<ssm:MappingEntry source="strength" target="a.factor"/></ssm:ParameterMapping>
"""

REFERENCES = {  # an experiment that an FMU ships, FMI-LS-REF
    f"{FOLDER}/fmi-ls-manifest.xml": b"""<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
 fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref">
<Related type="application/x-ma-hs-experiments" source="experiment.exp" role="experiment/validation"/>
<Related type="text/csv" source="result.csv" role="result"/></fmiReferences>""",
    f"{FOLDER}/experiment.exp": b"""<Experiments><Experiment name="step" startTime="0" stopTime="1">
<References type="text/csv" source="result.csv"/><Stimuli type="text/csv" source="input.csv"/>
<Parameters source="parameters.ssv" type="application/x-ssp-parameter-set"/></Experiment></Experiments>""",
    f"{FOLDER}/result.csv": b"time,y\n0,0\n0.5,0.6\n1,0.8\n",
    f"{FOLDER}/input.csv": b"time,u\n0,1\n1,1\n",
    f"{FOLDER}/parameters.ssv": START.encode(),
}
Good = Mapping[str, bytes]


def packed(members: Good) -> bytes:
    """An archive of these members."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return buffer.getvalue()


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """Small FMUs with a library."""
    return Workshop(tmp_path_factory.mktemp("any_fmu"))


@pytest.fixture(scope="module")
def good(fmus: Workshop) -> Mapping[str, Good]:
    """Suffix and content of good files: FMUs of both versions, and an SSP with all that the reader reads."""
    icon, library = b"\x89PNG\r\n\x1a\n", fmus.library
    gain = fmus["gain"].read_bytes()
    return {
        "fmi2": {
            DESCRIPTION: XML_2.encode(),
            "documentation/index.html": b"<html></html>",
            "terminalsAndIcons/terminalsAndIcons.xml": TERMINALS.encode(),
            "terminalsAndIcons/icon.png": icon,
            "binaries/linux64/lag.so": library,
            "sources/lag.c": b"int x;",
            **REFERENCES,
        },
        "fmi3": {
            DESCRIPTION: XML_3.encode(),
            "sources/buildDescription.xml": BUILD.encode(),
            "terminalsAndIcons/terminalsAndIcons.xml": TERMINALS.encode(),
            "binaries/x86_64-linux/lag.so": library,
            "resources/model.py": b"class Model: pass",
        },
        "ssp": {
            "SystemStructure.ssd": OUTER.encode(),
            "other.ssd": INNER.encode(),
            "resources/gain.fmu": gain,
            "resources/start.ssv": START.encode(),
            "resources/names.ssm": MAPPING.encode(),
            "resources/view.toml": VIEW.read_bytes(),
            "resources/inner.ssp": packed(
                {"SystemStructure.ssd": INNER.encode(), "resources/gain.fmu": gain}
            ),
        },
    }


# ---- what a file may do ------------------------------------------------------------------------------------


class Touched:
    """Files that the process writes, removes or loads as libraries, by the audit events of Python."""

    writing = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
    changes = ("os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.symlink", "os.link", "os.chmod")

    def __init__(self) -> None:
        self.paths: list[str] | None = None
        sys.addaudithook(self._note)

    def _note(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.paths is None:
            return
        if event == "open":
            path, _, flags = arguments
            secret = isinstance(path, (str, bytes)) and "passwd" in os.fsdecode(path)
            if secret or (isinstance(flags, int) and flags & self.writing):
                self.paths.append(str(path))
        elif event in self.changes or event == "ctypes.dlopen":
            self.paths.append(f"{arguments[0]}")


touched = Touched()


@contextmanager
def watched(folder: Path) -> Iterator[None]:
    """Nothing outside of a temporary folder may be touched, and nothing may be left there."""
    temporary, before = folder / "temporary", tempfile.tempdir
    temporary.mkdir(exist_ok=True)
    tempfile.tempdir, touched.paths = str(temporary), []
    try:
        yield
    finally:
        paths, touched.paths, tempfile.tempdir = touched.paths, None, before
    inside = (str(temporary), "None")
    outside = [p for p in paths if os.path.isabs(p) and not p.startswith(inside) and "__pycache__" not in p]
    assert not outside, outside
    assert not list(temporary.iterdir())


def read_fmu(path: Path, system: System) -> None:
    """All that reads an FMU before it is loaded: to run it, to linearise it, to swap it, to list it."""
    for work in (
        lambda: used(load(path)),
        lambda: load(path, exchange=True),
        lambda: used(with_swaps(system, {"b": path})),
    ):
        with suppress(Problem):
            work()


def shipped(folder: Path) -> None:
    """The experiments that an FMU ships."""
    for case in cases(folder, manifest(folder))[0]:
        for file in filter(None, (case.reference, case.stimuli)):
            with suppress(Problem):
                table(file)
        if case.parameters:
            with suppress(Problem):
                parameter_set(case.parameters)


def read_ssp(path: Path, _: System) -> None:
    """All that reads an SSP before its FMUs are loaded."""
    with suppress(Problem):
        system = load(path)
        used(system)
        for name in parameter_sets(system):
            with suppress(Problem):
                with_sets(system, [name])


def used(system: System) -> None:
    """What happens to a system that has been read, until the first FMU is loaded."""
    for work in (lambda: output_order(system), lambda: list(lines(system)), lambda: view_description(system)):
        with suppress(Problem):
            work()
    for component in system.components.values():
        with suppress(Problem):
            component.value(next(iter(component.interface.variables), ""))
        if component.source is not None:
            with suppress(Problem), component.source.unpacked():
                pass


def checked(path: Path) -> None:
    """The static rules of `check`: no rule fails, each finding is a line for a terminal."""
    report = check(path, run=False)
    defects = [f.text for f in report.findings if f.rule == DEFECT]
    assert not defects, defects
    assert all(f.text.isprintable() and len(f.text) < 3000 for f in report.findings)
    report.text()
    with open_subject(path) as subject, suppress(Problem):
        shipped(subject.folder)
        subject.model.for_run()


def peak() -> float:
    """The largest resident memory of this process so far [bytes]; 0 where that is unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)


def examine(path: Path, content: bytes, read: Callable[[Path, System], None], system: System) -> str:
    """Why a file is not handled as it should be; empty if it is."""
    path.write_bytes(content)
    start, before = time.perf_counter(), peak()
    try:
        with watched(path.parent):
            read(path, system)
            checked(path)
    except Exception as error:  # any: the test reports it with its seed
        return f"{type(error).__name__}: {str(error)[:300]}"
    duration, growth = time.perf_counter() - start, peak() - before
    if duration > LONGEST or growth > MOST:
        return f"{duration:.1f} s, {growth / 1e6:.0f} MB"
    return ""


def faults(kind: str, good: Mapping[str, Good], seeds: range, folder: Path, system: System) -> dict[int, str]:
    """Seed -> why the file with this damage is not handled as it should be."""
    path, read = (folder / "x.ssp", read_ssp) if kind == "ssp" else (folder / "x.fmu", read_fmu)
    results = {seed: examine(path, damaged(good[kind], seed), read, system) for seed in seeds}
    return {seed: result for seed, result in results.items() if result}


@pytest.fixture(scope="module")
def system(good: Mapping[str, Good], tmp_path_factory: pytest.TempPathFactory) -> System:
    """A good system, into which FMUs are swapped; reading it imports what tests of writes must not see."""
    folder = tmp_path_factory.mktemp("system")
    (folder / "good.ssp").write_bytes(packed(good["ssp"]))
    (folder / "good.fmu").write_bytes(packed(good["fmi2"]))
    system = load(folder / "good.ssp")
    used(system)
    checked(folder / "good.fmu")
    return system


@pytest.mark.parametrize("kind", ["fmi2", "fmi3", "ssp"])
def test_damage_is_told(kind: str, good: Mapping[str, Good], system: System, tmp_path: Path) -> None:
    """No other exception than Problem, no defect of a rule, nothing touched, and all that in bounds."""
    assert faults(kind, good, range(115), tmp_path, system) == {}


@shards.search
@pytest.mark.parametrize("kind", ["fmi2", "fmi3", "ssp"])
def test_much_damage_is_told(kind: str, good: Mapping[str, Good], system: System, tmp_path: Path) -> None:
    """The same for other seeds."""
    assert faults(kind, good, range(1000, 6000), tmp_path, system) == {}
