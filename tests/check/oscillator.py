"""The FMUs of oscillator.c: FMI 2 and FMI 3, good, or with one fault in the binary or in the text."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import fmpy
from kit.compile import library

SOURCE = Path(__file__).with_name("oscillator.c")
PLATFORM = {2: fmpy.platform, 3: fmpy.platform_tuple}
STEP, STOP = 0.01, 2.0
# name, causality, attributes of the value, other attributes
VARIABLES = (
    ("time", "independent", "", ""),
    ("u", "input", 'start="0"', ""),
    ("stiffness", "parameter", 'start="40"', 'variability="fixed"'),
    ("damping", "parameter", 'start="0.5"', 'variability="fixed"'),
    ("x", "local", 'start="1"', 'initial="exact"'),
    ("v", "local", 'start="0"', 'initial="exact"'),
    ("der_x", "local", 'derivative="5"', ""),
    ("der_v", "local", 'derivative="6"', ""),
    ("position", "output", "", ""),
    ("force", "output", "", ""),
)
# unknown -> knowns, by number of the variable counted from 0
OUTPUTS = {8: (4,), 9: (1, 4, 5)}
DERIVATIVES = {6: (5,), 7: (1, 4, 5)}
CAN_2 = (
    'canGetAndSetFMUstate="true" canSerializeFMUstate="true" providesDirectionalDerivative="true"'
    ' modelIdentifier="oscillator"'
)
CAN_3 = CAN_2.replace("FMUstate", "FMUState").replace("Derivative=", "Derivatives=")
CAN_3 += ' providesAdjointDerivatives="true"'
SLAVE = 'canHandleVariableCommunicationStepSize="true" maxOutputDerivativeOrder="1"'
UPDATE = 'providesIntermediateUpdate="true" canReturnEarlyAfterIntermediateUpdate="true"'
CATEGORIES = '<LogCategories><Category name="logEvents"/><Category name="logStatusError"/></LogCategories>'
EXPERIMENT = f'<DefaultExperiment startTime="0" stopTime="{STOP}" stepSize="{STEP}"/>'


def description(major: int) -> str:
    """modelDescription.xml."""
    return _two() if major == 2 else _three()


def _two() -> str:
    lines = [
        f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}" {more}>'
        f"<Real {value}/></ScalarVariable>"
        for i, (name, causality, value, more) in enumerate(VARIABLES)
    ]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="oscillator" guid="oscillator" numberOfEventIndicators="0">
<ModelExchange {CAN_2}/><CoSimulation {CAN_2} {SLAVE}/>{CATEGORIES}{EXPERIMENT}
<ModelVariables>{"".join(lines)}</ModelVariables>
<ModelStructure><Outputs>{_unknowns("Unknown", "index", OUTPUTS, 1)}</Outputs>
<Derivatives>{_unknowns("Unknown", "index", DERIVATIVES, 1)}</Derivatives></ModelStructure>
</fmiModelDescription>
"""


def _three() -> str:
    lines = [
        f'<Float64 name="{name}" valueReference="{i}" causality="{causality}" {_by_reference(value)} {more}/>'
        for i, (name, causality, value, more) in enumerate(VARIABLES)
    ]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="oscillator" instantiationToken="oscillator">
<ModelExchange {CAN_3}/><CoSimulation {CAN_3} {SLAVE} {UPDATE}/>{CATEGORIES}{EXPERIMENT}
<ModelVariables>{"".join(lines)}</ModelVariables>
<ModelStructure>{_unknowns("Output", "valueReference", OUTPUTS, 0)}
{_unknowns("ContinuousStateDerivative", "valueReference", DERIVATIVES, 0)}</ModelStructure>
</fmiModelDescription>
"""


def _by_reference(value: str) -> str:
    """FMI 3 names the state of a derivative by its value reference, FMI 2 by its place, counted from 1."""
    return value.replace('derivative="5"', 'derivative="4"').replace('derivative="6"', 'derivative="5"')


def _unknowns(tag: str, key: str, table: Mapping[int, tuple[int, ...]], base: int) -> str:
    return "".join(
        f'<{tag} {key}="{i + base}" dependencies="{" ".join(str(d + base) for d in known)}"/>'
        for i, known in table.items()
    )


@dataclass
class Oscillators:
    """Makes FMUs in `folder`."""

    folder: Path

    def make(
        self,
        major: int = 2,
        fault: str = "none",
        change: tuple[str, str] = ("", ""),
        extra: Mapping[str, str] | None = None,
    ) -> Path:
        """One FMU: with a fault in the binary, a changed text in modelDescription.xml, more members."""
        path = self.folder / f"oscillator_{len(list(self.folder.iterdir()))}.fmu"
        text = description(major)
        assert change[0] in text
        mark, wanted = b"FAULT=none", f"FAULT={fault}".encode()
        plain = library("oscillator", [SOURCE], "-std=gnu11", "-fno-sanitize=undefined")
        binary = plain.replace(mark + bytes(14), wanted + bytes(24 - len(wanted)))
        assert (binary == plain) == (fault == "none")
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", text.replace(*change) if change[0] else text)
            name = f"binaries/{PLATFORM[major]}/oscillator{fmpy.sharedLibraryExtension}"
            archive.writestr(name, binary)
            for member, content in (extra or {}).items():
                archive.writestr(member, content)
        return path
