"""FMUs with a fault of choice in a phase of choice, and systems and studies that contain one.

The library is compiled once per version of FMI: the instantiation token of an FMU names its fault.
"""

import shutil
import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import fmpy
from check.good import DESCRIPTION, SOURCE, XML_2, XML_3, Archive
from kit.compile import library
from kit.mistakes import entry

from orchestrator.base.compiler import SUFFIX

FLAGS = ("-std=gnu11", "-fno-sanitize=undefined", "-Wno-unused-parameter", "-Wno-infinite-recursion", "-s")
FLAGS += ("-lrt",) if sys.platform == "linux" else ()
HANGS = ("spin", "sleep")
MISUSES, CAUSES = entry(__file__, "misuses"), entry(__file__, "causes")
HARMLESS = ("none", "fork", "daemon", "print")  # the run ends as if nothing had happened
FAULTS = (*CAUSES, *HANGS, "nan", *HARMLESS[1:])
PHASES = ("instantiate", "initialise", "step", "free")
# with one version of FMI, on which only the names of the functions depend: each fault and phase has both.
# a study has every fault in every phase with both
PAIRS = product(enumerate(FAULTS), enumerate(PHASES))
CASES = tuple((fault, phase, 3 - (i + j) % 2) for (i, fault), (j, phase) in PAIRS)
# FMI functions of the phases, without prefix
CALLS = dict(zip(PHASES, ("Instantiate", "ExitInitializationMode", "DoStep", "FreeInstance"), strict=True))
BEGIN = 0.5  # [s]; the fault `step` is committed in the step that begins here
MEMORY = 0.5  # [GB], the limit in the tests: above the 0.15 GB of a process, below the 4 GB that `leak` takes
STUDY = Path(__file__).with_name("study.toml").read_text("utf-8")


@dataclass(frozen=True)
class Faulty:
    """An FMU whose fault is committed when it enters the phase; `committed` is a file that it writes then."""

    fmu: Path
    fault: str
    phase: str
    major: int

    @property
    def committed(self) -> Path:
        """Contains the id of the process, or of the child that it has left behind."""
        return self.fmu.with_suffix(".committed")

    @property
    def harmless(self) -> bool:
        """The run ends as if nothing had happened; after the end nobody sees values."""
        return self.fault in HARMLESS or (self.fault, self.phase) == ("nan", "free")

    @property
    def call(self) -> str:
        """The FMI function that does not return."""
        simulation = "CoSimulation" if (self.phase, self.major) == ("instantiate", 3) else ""
        return f"fmi{self.major}{CALLS[self.phase]}{simulation}"

    def assert_told(self, message: str, component: str, cause: str = "") -> None:
        """One line has what happened, the call and the FMU; `cause` is of what does not end the process."""
        assert "\n" not in message
        if self.fault == "nan":
            assert message.removeprefix("harvester: ").startswith(f"{component}.y: expected a ")
            assert " got nan" in message
            return
        assert (cause or CAUSES[self.fault]) in message
        assert f" in {self.call} " in message
        assert f" of {component} ({self.fmu})" in message


def faulty(
    folder: Path, fault: str = "none", phase: str = "step", major: int = 2, name: str = "lag"
) -> Faulty:
    """Make an FMU."""
    made = Faulty(folder / f"{name}.fmu", fault, phase, major)
    description, platform = (XML_2, fmpy.platform) if major == 2 else (XML_3, fmpy.platform_tuple)
    attribute = "guid" if major == 2 else "instantiationToken"
    archive = Archive(major, {DESCRIPTION: description.encode()})
    token = description.partition(f'{attribute}="')[2].partition('"')[0]
    archive = archive.swap(f'"{token}"', f'"{token} {fault} {phase} {made.committed}"')
    exchange = description.partition("<ModelExchange")[2].partition("<CoSimulation")[0]
    archive = archive.swap(f"<ModelExchange{exchange}", "")
    unused = [f' providesDirectionalDerivative{"s" * (major - 2)}="true"']
    unused += ['<SourceFiles><File name="lag.c"/></SourceFiles>'] if major == 2 else []
    for text in unused:
        archive = archive.swap(text, "")
    sources = [Path(__file__).with_name("faulty.c")]
    binary = library(f"faulty{major}", sources, *FLAGS, f"-DFMI={major}", included=[SOURCE])
    archive.put(f"binaries/{platform}/lag{SUFFIX}", binary).write(made.fmu)
    return made


def two_lags(folder: Path) -> Path:
    """A system of two good FMUs, `first` and `second`."""
    faulty(folder)
    return Path(shutil.copy(Path(__file__).with_name("two.ssd"), folder))


def study(folder: Path, system: Path, output: str, settings: str) -> Path:
    """A study of a system; settings: what is varied, and limits."""
    file = folder / "study.toml"
    text = STUDY.format(system=system.name, output=output, settings=settings, memory=MEMORY)
    file.write_text(text, encoding="utf-8")
    return file
