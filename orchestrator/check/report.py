"""What each tool makes of what the rules find. One row per tool and rule; the evidence stands beside it.

Simulink, Dymola, Amesim and fmusim were judged by issue threads, without running them. The others run in
this project's tests or in `make matrix`, or their sources were read. A thread is evidence for the tool that
imports the FMU; one about FMUs that a tool has made stands beside the rule only.

What a check found, for people and for programs.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

from orchestrator.check.finding import SEVERITIES, Finding, Rule, Severity


@dataclass(frozen=True)
class Verdict:
    """What one tool makes of one rule: at least `severity`, and why."""

    severity: Severity
    why: str
    thread: str


@dataclass(frozen=True)
class Tool:
    """One tool; `known_by` tells how its verdicts were found."""

    id: str
    name: str
    known_by: str
    verdicts: Mapping[str, Verdict]


ANY = "any"
THREADS = "by issue threads, not by running the tool"
RUN = "by running it in this project's tests, and by issue threads"
READ = "by reading its sources, and by issue threads"
MATRIX = "by running it (`make matrix`), by reading its sources, and by issue threads"


def _error(why: str, thread: str) -> Verdict:
    return Verdict("error", why, thread)


def _warning(why: str, thread: str) -> Verdict:
    return Verdict("warning", why, thread)


def _note(why: str, thread: str) -> Verdict:
    return Verdict("note", why, thread)


SIMULINK = Tool(
    "simulink",
    "Simulink",
    THREADS,
    {
        "name.structured": _warning("makes buses of structured names", "Hopsan#2266 Hopsan#2280 OSMP#70"),
        "name.length": _warning("takes no parameter name of more than 63 characters", "FMIKit#341"),
        "name.characters": _warning("makes MATLAB names of them", "FMIKit#341"),
        "name.mangled": _warning("may map both to one MATLAB name", "FMIKit#341"),
        "python.needed": _error(
            "MATLAB crashes on the first or second run", "PythonFMU#222 PythonFMU#208 UniFMU#61"
        ),
        "platform.windows": _warning("on Windows needs this binary", "FMIKit#145"),
        "structure.dependencies": _warning("sees algebraic loops that are not there", "FMIKit#21"),
        "ability.once": _warning("cannot have two blocks of it in a model", "FMIKit#328 FMIKit#397"),
        "ability.tool": _warning("the FMU fails without its tool", "FMIKit#373"),
        "ability.state": _note("no fast restart", "FMIKit#448"),
        "ability.serialize": _note("no fast restart", "FMIKit#448"),
        "experiment.step": _note("communication points drift by rounding", "FMIKit#133"),
        "identity.token": _note("a wrong GUID stops the import", "FMIKit#80"),
        "run.default": _warning("waits without end when a step hangs", "FMIKit#225"),
        "run.first_output": _warning("shows the first output as it is after initialisation", "FMIKit#219"),
        "run.drift": _warning("sums its communication points", "FMIKit#133"),
        "run.instances": _warning("each block is an instance in one process", "FMIKit#328 FMIKit#397"),
        "run.state": _warning("restores states at a fast restart", "FMIKit#448"),
    },
)
DYMOLA = Tool(
    "dymola",
    "Dymola",
    THREADS,
    {
        "python.needed": _error("the model fails to initialise", "PythonFMU#184"),
        "platform.windows": _warning("on Windows needs this binary", "FMPy#407"),
        "name.keyword": _warning("such a name is no Modelica identifier", ""),
        "name.mangled": _warning("two names may become one", "Modelica-FMI#22"),
    },
)
OPENMODELICA = Tool(
    "openmodelica",
    "OpenModelica",
    RUN,
    {
        "structure.initial": _warning("lists the missing unknowns as warnings", "OpenModelica#8080"),
        "name.keyword": _warning("such a name is no Modelica identifier", "OpenModelica#5706"),
        "name.characters": _warning(
            "the imported Modelica code may not compile", "OpenModelica#4707 OpenModelica#5706"
        ),
        "name.mangled": _warning("two names may become one", "Modelica-FMI#22"),
        "run.late": _error(
            "sets parameters, states and the time there", "OpenModelica#16354 OpenModelica#12893"
        ),
        "version.new": _warning(
            "imports FMI 3.0 only since pull request 16268 (2026), Model Exchange", "OpenModelica#16268"
        ),
        "kind.exchange": _warning(
            "importFMU takes Model Exchange, OMSimulator Co-Simulation", "OpenModelica#2626"
        ),
    },
)
AMESIM = Tool(
    "amesim",
    "Amesim",
    THREADS,
    {
        "structure.initial": _warning("warns 'Missing InitialUnknown index'", "PythonFMU#112 Simulix#28"),
        "variable.duplicate": _error("refuses: 'Duplicate scalar variable name'", "Simulix#28"),
        "platform.windows": _warning("on Windows needs this binary", "PythonFMU#112"),
        "python.needed": _error("the import works, the run needs Python", "PythonFMU#112"),
    },
)
FMPY = Tool(
    "fmpy",
    "FMPy",
    RUN,
    {
        "unit.undefined": _error("refuses undefined units", "FMPy#511"),
        "variable.combination": _error("refuses the combination", "FMPy#189 FMPy#108 FMPy#579"),
        "variable.string": _note("simulate_ssp passes no strings on", ""),
        "binary.functions": _error(
            "'Function ... is missing in shared library'", "FMPy#545 FMPy#642 FMPy#552 FMPy#700"
        ),
        "version.new": _warning("simulate_ssp takes FMI 1 and 2 only", ""),
        "experiment.step": _note("communication points drift by rounding", "FMPy#887"),
        "run.load": _error("cannot load the library", "FMPy#545 FMPy#642"),
        "run.drift": _warning("sums its communication points", "FMPy#887"),
        "run.start_time": _warning("starts at other times than 0", "FMPy#638"),
        "run.serialize": _warning("restores states of another process", "FMPy#811"),
        "run.leak": _warning("many instances one after another", "FMPy#110 FMPy#608 FMPy#343"),
        "run.resources": _warning("unpacks to folders of all names", "FMPy#230"),
    },
)
FMUSIM = Tool(
    "fmusim",
    "fmusim",
    THREADS,
    {
        "name.grammar": _error("refuses names that break the grammar", "Reference-FMUs#409"),
        "structure.initial": _error("refuses an FMU without the expected unknowns", "OpenModelica#15692"),
        "unit.undefined": _error("refuses undefined units", "FMPy#511"),
        "python.needed": _error("'Failed to load shared library'", "PythonFMU#192 PythonFMU#202"),
        "binary.functions": _error("refuses an FMU without them", "Reference-FMUs#645"),
    },
)
PYFMI = Tool(
    "pyfmi",
    "PyFMI",
    READ,
    {
        "version.new": _warning("takes FMI 3.0 for Model Exchange only", ""),
        "binary.functions": _error("FMI Library looks up all of them", "fmi-library#148"),
        "ability.derivatives": _note(
            "algebraic loops are solved with directional derivatives only", "PyFMI#83"
        ),
        "structure.dependencies": _warning("sees algebraic loops that are not there", "PyFMI#232"),
        "run.start_time": _warning("starts at other times than 0", "PyFMI#261"),
    },
)
OMSIMULATOR = Tool(
    "omsimulator",
    "OMSimulator",
    MATRIX,
    {
        "version.new": _warning("FMI 3.0 is a prototype", "OMSimulator#1523"),
        "structure.initial": _warning(
            "lists the missing unknowns as warnings", "OMSimulator#838 OpenModelica#8080"
        ),
        "structure.dependencies": _warning("sees algebraic loops that are not there", "PythonFMU#258"),
        "structure.rates": _error(
            "in Model Exchange counts them as states: 'fmi2GetContinuousStates: 7 states, expected 4'", ""
        ),
        "python.needed": _error("the library does not load", ""),
    },
)
ECOS = Tool("ecos", "Ecos", RUN, {"unit.factor": _note("does not convert units", "")})
LIBCOSIM = Tool(
    "libcosim",
    "libcosim",
    RUN,
    {
        "version.new": _error("takes FMI 1 and 2 only", ""),
        "unit.factor": _note("does not convert units", "libcosim#519"),
    },
)
TOOLS = {
    t.id: t
    for t in (SIMULINK, DYMOLA, OPENMODELICA, AMESIM, FMPY, FMUSIM, PYFMI, OMSIMULATOR, ECOS, LIBCOSIM)
}


def seen_in(rule: str) -> tuple[Tool, ...]:
    """The tools that have a verdict on a rule."""
    return tuple(t for t in TOOLS.values() if rule in t.verdicts)


SHOWN = 5  # findings of one rule that are printed one by one
TITLES = {"error": "errors", "warning": "warnings", "note": "notes"}


@dataclass(frozen=True)
class Report:
    """All findings on one FMU; `tool` is the tool asked for, or any."""

    path: Path
    title: str
    everything: tuple[Finding, ...]
    tool: str = ANY

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Those that concern the tool, worst first; with the tool's own verdict on how bad it is."""
        if self.tool == ANY:
            return tuple(sorted(self.everything, key=_rank))
        verdicts = TOOLS[self.tool].verdicts
        concerned = [f for f in self.everything if not f.tools or self.tool in f.tools or f.rule in verdicts]
        return tuple(sorted((_judged(f, self.tool) for f in concerned), key=_rank))

    def count(self, severity: str) -> int:
        return sum(f.severity == severity for f in self.findings)

    @property
    def failed(self) -> bool:
        return self.count("error") > 0

    def text(self) -> str:
        """One line for each finding, grouped by severity."""
        lines = [f"{self.path}: {self.title}"]
        if self.tool != ANY:
            tool = TOOLS[self.tool]
            lines.append(f"for {tool.name}, judged {tool.known_by}")
        for severity in SEVERITIES:
            found = [f for f in self.findings if f.severity == severity]
            lines += ["", TITLES[severity], *self._lines(found)] if found else []
        return "\n".join([*lines, "", self.summary()])

    def summary(self) -> str:
        """The counts in one line."""
        counts = [(self.count(s), s) for s in SEVERITIES]
        told = ", ".join(f"{n} {s}{'' if n == 1 else 's'}" for n, s in counts)
        hidden = len(self.everything) - len(self.findings)
        rest = f"; {hidden} more for other tools" if hidden else ""
        return (told if self.findings else "nothing found") + rest

    def _lines(self, found: list[Finding]) -> Iterator[str]:
        width = max(len(f.rule) for f in found)
        for rule in dict.fromkeys(f.rule for f in found):
            same = [f for f in found if f.rule == rule]
            for f in same[:SHOWN]:
                yield f"  {f.rule:{width}}  {f.text}{self._why(f)}"
            if len(same) > SHOWN:
                yield f"  {rule:{width}}  ... and {len(same) - SHOWN} more of this kind"

    def _why(self, f: Finding) -> str:
        """Which tool makes what of it, and where that was seen."""
        if self.tool != ANY and f.rule in TOOLS[self.tool].verdicts:
            verdict = TOOLS[self.tool].verdicts[f.rule]
            return f" [{TOOLS[self.tool].name}: {verdict.why}{_seen(verdict.thread)}]"
        named = [t.name for t in seen_in(f.rule)] if self.tool == ANY else []
        return f" [{', '.join(named) or 'see'}{_seen(f.thread, ': ' if named else ' ')}]" if f.thread else ""

    def json(self) -> str:
        """Everything, for programs."""
        data = {
            "file": str(self.path),
            "title": self.title,
            "tool": self.tool,
            "counts": {s: self.count(s) for s in SEVERITIES},
            "findings": [asdict(f) for f in self.findings],
        }
        return json.dumps(data, indent=1)


def _seen(thread: str, joint: str = "; ") -> str:
    return f"{joint}{thread}" if thread else ""


def _rank(f: Finding) -> int:
    return SEVERITIES.index(f.severity)


def _judged(f: Finding, tool: str) -> Finding:
    """The finding, at least as bad as the tool takes it."""
    verdict = TOOLS[tool].verdicts.get(f.rule)
    if verdict is None or SEVERITIES.index(verdict.severity) >= _rank(f):
        return f
    return replace(f, severity=verdict.severity)


def table(rules: tuple[Rule, ...]) -> str:
    """All rules as a Markdown table."""
    lines = ["| rule | what must hold | tools | seen in |", "|---|---|---|---|"]
    for rule in rules:
        tools = ", ".join(t.name for t in seen_in(rule.id)) or "any"
        lines.append(f"| `{rule.id}` | {rule.text} | {tools} | {' '.join(rule.threads)} |")
    return "\n".join(lines)
