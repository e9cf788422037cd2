"""The models in any_fmu.c as modelDescription.xml, and the archives around them."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import fmpy

SOURCE = Path(__file__).with_name("any_fmu.c")
BASE = {  # unit -> BaseUnit attributes
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "bar": {"kg": 1, "m": -1, "s": -2, "factor": 1e5},
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "kg": {"kg": 1},
    "N/m": {"kg": 1, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "Hz": {"s": -1},
    "K": {"K": 1},
    "degC": {"K": 1, "offset": 273.15},
    "odd": None,  # a unit without definition
}


@dataclass(frozen=True)
class V:
    """One variable; `depends` are the inputs an output depends on directly, None leaves that undeclared."""

    name: str
    causality: str
    unit: str | None = None
    start: object = None
    kind: str = "Real"
    depends: Sequence[str] | None = ()
    variability: str | None = None


MODELS: Mapping[str, list[V]] = {
    "mass_a": [
        V("x2", "input", "m", 0.0),
        V("force", "output", "N", depends=["x2"]),
        V("x", "output", "m"),
        V("v", "output", "m/s"),
        V("mass", "parameter", "kg", 1.0),
        V("spring", "parameter", "N/m", 10.0),
        V("coupling", "parameter", "N/m", 100.0),
    ],
    "mass_b": [
        V("force", "input", "N", 0.0),
        V("x", "output", "m"),
        V("v", "output", "m/s"),
        V("mass", "parameter", "kg", 1.0),
        V("spring", "parameter", "N/m", 1000.0),
    ],
    "spring": [
        V("v", "input", "m/s", 0.0),
        V("force", "output", "N"),
        V("stretch", "output", "m"),
        V("stiffness", "parameter", "N/m", 100.0),
    ],
    "source": [
        V("y", "output", "m"),
        V("amplitude", "parameter", "m", 1.0),
        V("omega", "parameter", "rad/s", 1.0),
        V("offset", "parameter", "m", 0.0),
    ],
    "gain": [
        V("u", "input", "m", 0.0),
        V("y", "output", "m", depends=["u"]),
        V("factor", "parameter", None, 1.0),
        V("offset", "parameter", "m", 0.0),
    ],
    "fails": [
        V("u", "input", None, 0.0),
        V("y", "output"),
        V("when", "parameter", None, 1e9),
        V("how", "parameter", None, 0, "Integer"),
    ],
    "types": [
        V("real_in", "input", None, 0.0),
        V("real_out", "output", None, depends=["real_in"]),
        V("gain", "parameter", None, 1.0),
        V("int_in", "input", None, 0, "Integer"),
        V("int_out", "output", None, kind="Integer", depends=["int_in"]),
        V("bool_in", "input", None, "false", "Boolean"),
        V("bool_out", "output", None, kind="Boolean", depends=["bool_in"]),
        V("enum_in", "input", None, 1, "Enumeration"),
        V("enum_out", "output", None, kind="Enumeration", depends=["enum_in"]),
        V("alive", "output", None, kind="Integer"),
        V("label", "parameter", None, "nobody", "String"),
        V("echo", "output", None, kind="String"),
    ],
}


@dataclass
class Workshop:
    """Makes FMUs of the models in `folder`; the library is compiled once."""

    folder: Path
    library: bytes = b""
    _made: dict[str, Path] = field(default_factory=dict)

    def compile(self) -> Workshop:
        """Compile any_fmu.c for this machine."""
        target = self.folder / f"any_fmu{fmpy.sharedLibraryExtension}"
        headers = Path(fmpy.__file__).parent / "c-code"
        flags = ["-std=c99", "-O2", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror", f"-I{headers}"]
        command = [sys.executable, "-m", "ziglang", "cc", *flags, str(SOURCE), "-o", str(target), "-lm"]
        subprocess.run(command, check=True, capture_output=True, text=True)
        self.library = target.read_bytes()
        return self

    def __getitem__(self, model: str) -> Path:
        """The plain FMU of a model."""
        if model not in self._made:
            self._made[model] = self.make(model)
        return self._made[model]

    def make(
        self,
        model: str,
        name: str | None = None,
        units: Mapping[str, str] | None = None,
        undeclared: bool = False,
        platform: str | None = None,
        version: str = "2.0",
        kind: str = "CoSimulation",
        guid: str | None = None,
        interpolates: bool = False,
        extra: Mapping[str, str] | None = None,
    ) -> Path:
        """An FMU that differs from the plain one.

        units        variable -> other unit
        undeclared   leave out all dependencies
        platform     folder of the binary; "" for none
        """
        name = name or model
        path = self.folder / f"{name}.fmu"
        variables = [
            V(v.name, v.causality, (units or {}).get(v.name, v.unit), v.start, v.kind, v.depends)
            for v in MODELS[model]
        ]
        text = describe(name, guid or model, variables, undeclared, version, kind, interpolates)
        where = fmpy.platform if platform is None else platform
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", text)
            if where:
                archive.writestr(f"binaries/{where}/{name}{fmpy.sharedLibraryExtension}", self.library)
            for member, content in (extra or {}).items():
                archive.writestr(member, content)
        return path


def describe(
    name: str, guid: str, variables: list[V], undeclared: bool, version: str, kind: str, interpolates: bool
) -> str:
    """modelDescription.xml."""
    index = {v.name: i + 1 for i, v in enumerate(variables)}
    counts = {"Real": 0, "Whole": 0, "String": 0}
    lines = []
    for v in variables:
        family = v.kind if v.kind in counts else "Whole"
        lines.append(_scalar(v, counts[family]))
        counts[family] += 1
    unknowns = "".join(_unknown(v, index, undeclared) for v in variables if v.causality == "output")
    used = sorted({v.unit for v in variables if v.unit})
    ability = "canHandleVariableCommunicationStepSize='true' canGetAndSetFMUstate='true'"
    ability += " maxOutputDerivativeOrder='1'" + (" canInterpolateInputs='true'" if interpolates else "")
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}" modelName="{name}" guid="{guid}">
<{kind} modelIdentifier="{name}" {ability if kind == "CoSimulation" else ""}/>
{"<UnitDefinitions>" + "".join(map(_unit, used)) + "</UnitDefinitions>" if used else ""}
<TypeDefinitions><SimpleType name="Colour"><Enumeration>
<Item name="red" value="1"/><Item name="green" value="2"/></Enumeration></SimpleType></TypeDefinitions>
<LogCategories><Category name="logStatusWarning"/><Category name="logStatusError"/></LogCategories>
<ModelVariables>{"".join(lines)}</ModelVariables>
<ModelStructure><Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""


def _scalar(v: V, reference: int) -> str:
    attributes = {"unit": v.unit, "start": v.start if v.causality != "output" else None}
    if v.kind == "Enumeration":
        attributes["declaredType"] = "Colour"
    inner = "".join(f' {k}="{x}"' for k, x in attributes.items() if x is not None)
    steady = {"parameter": "fixed"}.get(v.causality, "continuous" if v.kind == "Real" else "discrete")
    return (
        f'<ScalarVariable name="{v.name}" valueReference="{reference}" causality="{v.causality}" '
        f'variability="{steady}"><{v.kind}{inner}/></ScalarVariable>'
    )


def _unknown(v: V, index: Mapping[str, int], undeclared: bool) -> str:
    if undeclared or v.depends is None:
        return f'<Unknown index="{index[v.name]}"/>'
    return f'<Unknown index="{index[v.name]}" dependencies="{" ".join(str(index[d]) for d in v.depends)}"/>'


def _unit(name: str) -> str:
    base = BASE[name]
    inner = "" if base is None else "<BaseUnit" + "".join(f' {k}="{x}"' for k, x in base.items()) + "/>"
    return f'<Unit name="{name}">{inner}</Unit>'
