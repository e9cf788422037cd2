"""Good FMUs, with all that a tool can wish for: the lag in good.c for FMI 2 and FMI 3, on four platforms."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from kit import compile
from kit.compile import SHARED

SOURCE = Path(__file__).with_name("good.c")
TARGETS = {  # target of the compiler -> folder in FMI 2, folder in FMI 3, suffix
    "x86_64-linux-gnu.2.17": ("linux64", "x86_64-linux", ".so"),
    "x86_64-windows-gnu": ("win64", "x86_64-windows", ".dll"),
    "x86_64-macos.11.0": ("darwin64", "x86_64-darwin", ".dylib"),
    "aarch64-macos.11.0": ("aarch64-darwin", "aarch64-darwin", ".dylib"),
}
DESCRIPTION = "modelDescription.xml"
UNITS = """<UnitDefinitions>
<Unit name="s"><BaseUnit s="1"/></Unit>
<Unit name="1/s"><BaseUnit s="-1"/></Unit>
<Unit name="Pa"><BaseUnit kg="1" m="-1" s="-2"/><DisplayUnit name="bar" factor="1e-5"/></Unit>
<Unit name="Pa/s"><BaseUnit kg="1" m="-1" s="-3"/></Unit>
</UnitDefinitions>"""
ABOUT = 'description="A first-order lag" author="tests" version="1" generationTool="by hand"'
EXPERIMENT = '<DefaultExperiment startTime="0" stopTime="10" tolerance="1e-6" stepSize="0.01"/>'
CATEGORIES = '<LogCategories><Category name="logStatusError"/></LogCategories>'
XML_2 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="lag" guid="{{31f3d6a2-6f0c-4b57-9d7e-0c1f6a5e9b42}}" {ABOUT}
 variableNamingConvention="flat" numberOfEventIndicators="0" license="MIT">
<ModelExchange modelIdentifier="lag" canGetAndSetFMUstate="true" canSerializeFMUstate="true"
 providesDirectionalDerivative="true"><SourceFiles><File name="lag.c"/></SourceFiles></ModelExchange>
<CoSimulation modelIdentifier="lag" canHandleVariableCommunicationStepSize="true" canInterpolateInputs="true"
 maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true" canSerializeFMUstate="true"
 providesDirectionalDerivative="true"><SourceFiles><File name="lag.c"/></SourceFiles></CoSimulation>
{UNITS}
<TypeDefinitions><SimpleType name="Gear"><Enumeration><Item name="low" value="1"/>
<Item name="high" value="2"/></Enumeration></SimpleType></TypeDefinitions>
{CATEGORIES}
{EXPERIMENT}
<ModelVariables>
<ScalarVariable name="time" valueReference="0" causality="independent" description="Time">
<Real unit="s"/></ScalarVariable>
<ScalarVariable name="u" valueReference="1" causality="input" description="Set pressure">
<Real unit="Pa" displayUnit="bar" start="0" min="0" max="1e8" nominal="1e7"/></ScalarVariable>
<ScalarVariable name="rate" valueReference="2" causality="parameter" variability="fixed" description="Rate">
<Real unit="1/s" start="2" min="0"/></ScalarVariable>
<ScalarVariable name="x" valueReference="3" initial="exact" description="State">
<Real unit="Pa" start="0"/></ScalarVariable>
<ScalarVariable name="der_x" valueReference="4" description="Derivative">
<Real unit="Pa/s" derivative="4"/></ScalarVariable>
<ScalarVariable name="y" valueReference="5" causality="output" description="Pressure">
<Real unit="Pa"/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="6" dependencies="4" dependenciesKind="constant"/></Outputs>
<Derivatives><Unknown index="5" dependencies="2 4" dependenciesKind="fixed fixed"/></Derivatives>
<InitialUnknowns>
<Unknown index="5" dependencies="2 3 4"/><Unknown index="6" dependencies="4"/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""
XML_3 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="lag"
 instantiationToken="{{9a0c6f5e-2a31-4f0e-8f57-6d1b7b6b3c55}}" {ABOUT} license="MIT">
<ModelExchange modelIdentifier="lag" canGetAndSetFMUState="true" canSerializeFMUState="true"
 providesDirectionalDerivatives="true"/>
<CoSimulation modelIdentifier="lag" canHandleVariableCommunicationStepSize="true" maxOutputDerivativeOrder="1"
 canGetAndSetFMUState="true" canSerializeFMUState="true" providesDirectionalDerivatives="true"/>
{UNITS}
<TypeDefinitions><EnumerationType name="Gear"><Item name="low" value="1"/><Item name="high" value="2"/>
</EnumerationType></TypeDefinitions>
{CATEGORIES}
{EXPERIMENT}
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" unit="s" description="Time"/>
<Float64 name="u" valueReference="1" causality="input" unit="Pa" displayUnit="bar" start="0"
 description="Set pressure"/>
<Float64 name="rate" valueReference="2" causality="parameter" variability="fixed" unit="1/s" start="2"
 description="Rate"/>
<Float64 name="x" valueReference="3" initial="exact" unit="Pa" start="0" description="State"/>
<Float64 name="der_x" valueReference="4" unit="Pa/s" derivative="3" description="Derivative"/>
<Float64 name="y" valueReference="5" causality="output" unit="Pa" description="Pressure"/>
</ModelVariables>
<ModelStructure>
<Output valueReference="5" dependencies="3" dependenciesKind="constant"/>
<ContinuousStateDerivative valueReference="4" dependencies="1 2 3"/>
<InitialUnknown valueReference="4" dependencies="1 2 3"/>
<InitialUnknown valueReference="5" dependencies="3"/>
</ModelStructure>
</fmiModelDescription>
"""
BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="lag"><SourceFileSet language="C99">
<SourceFile name="lag.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>
"""
TERMINALS = """<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals><Terminal name="port" matchingRule="plug">
<TerminalMemberVariable variableName="u" memberName="set" variableKind="signal"/>
<TerminalMemberVariable variableName="y" memberName="pressure" variableKind="signal"/>
</Terminal></Terminals></fmiTerminalsAndIcons>
"""


@dataclass(frozen=True)
class Archive:
    """The content of an FMU: what each member holds."""

    major: int
    members: Mapping[str, bytes]

    def library(self, target: str = "x86_64-linux-gnu.2.17") -> str:
        """The member that holds the library of a target."""
        names = TARGETS[target]
        return f"binaries/{names[self.major - 2]}/lag{names[2]}"

    def put(self, name: str, content: bytes | str) -> Archive:
        """With one more member, or another content of it."""
        data = content.encode() if isinstance(content, str) else content
        return replace(self, members={**self.members, name: data})

    def drop(self, *starts: str) -> Archive:
        """Without the members whose names start so."""
        return replace(self, members={n: d for n, d in self.members.items() if not n.startswith(starts)})

    def swap(self, old: str, new: str, member: str = DESCRIPTION) -> Archive:
        """With a text replaced, which must be there once."""
        text = self.members[member].decode()
        assert text.count(old) == 1, f"{old!r} is there {text.count(old)} times in {member}"
        return self.put(member, text.replace(old, new))

    def write(self, path: Path) -> Path:
        """The file."""
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in self.members.items():
                archive.writestr(name, data)
        return path


def compiled(target: str, *flags: str) -> bytes:
    """A library for a target; without debug information unless the flags ask for it."""
    # debug information without paths of this machine: they are a fault of their own
    more = (
        ["-fdebug-compilation-dir=project", f"-ffile-prefix-map={sys.prefix}=python"]
        if "-g" in flags
        else ["-s"]
    )
    more += ["-Wl,-install_name,@rpath/lag.dylib"] if "macos" in target else []
    flags = (*SHARED, "-std=c99", "-Wno-unused-parameter", *more, *flags)
    return compile.compiled(f"lag{TARGETS[target][2]}", [SOURCE], *flags, target=target).read_bytes()


def make(major: int) -> Archive:
    """The good FMU of a version."""
    icon = b"\x89PNG\r\n\x1a\n"
    members = {
        DESCRIPTION: (XML_2 if major == 2 else XML_3).encode(),
        "documentation/index.html": b"<html></html>",
        "documentation/licenses/license.txt": b"MIT",
        "sources/lag.c": SOURCE.read_bytes(),
        "terminalsAndIcons/icon.png": icon,
        "terminalsAndIcons/terminalsAndIcons.xml": TERMINALS.encode(),
    }
    if major == 2:
        members["model.png"] = icon
    else:
        members["sources/buildDescription.xml"] = BUILD.encode()
    archive = Archive(major, members)
    for target in TARGETS:
        archive = archive.put(archive.library(target), compiled(target, f"-DFMI={major}"))
    return archive
