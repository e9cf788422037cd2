"""The models in models.h as modelDescription.xml of FMI 2.0 or 3.0, and the archives around them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import fmpy

from kit.compile import library
from orchestrator import System, assemble

SOURCES = [Path(__file__).with_name(name) for name in ("models.c", "fmi2.c", "fmi3.c")]
WIDTHS = ("Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64")
BASE = {  # unit -> BaseUnit attributes
    "N": {"kg": 1, "m": 1, "s": -2},
    "N/s": {"kg": 1, "m": 1, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "bar": {"kg": 1, "m": -1, "s": -2, "factor": 1e5},
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "kg": {"kg": 1},
    "N/m": {"kg": 1, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "Hz": {"s": -1},
    "s": {"s": 1},
    "K": {"K": 1},
    "degC": {"K": 1, "offset": 273.15},
    "odd": None,  # a unit without definition
}


@dataclass(frozen=True)
class V:
    """One variable.

    depends   the inputs an output depends on directly; None leaves that undeclared
    derives   the variable whose time derivative this one is
    steady    its variability, where it is not the usual one
    place     its value reference, where that is not the next one
    """

    name: str
    causality: str
    unit: str | None = None
    start: object = None
    kind: str = "Real"
    depends: Sequence[str] | None = ()
    derives: str | None = None
    steady: str | None = None
    place: int | None = None


RATES = {  # more of the masses: their input moves at it
    "mass_a": V("x2_rate", "input", "m/s", 0.0, derives="x2"),
    "mass_b": V("force_rate", "input", "N/s", 0.0, derives="force"),
}
STATES = {  # more of the masses: time derivatives of their states
    "mass_a": [
        V("der_x", "local", "m/s", depends=["v"], derives="x", place=14),
        V("der_v", "local", "m/s2", depends=["x2", "x"], derives="v", place=15),
    ],
    "mass_b": [
        V("der_x", "local", "m/s", depends=["v"], derives="x", place=14),
        V("der_v", "local", "m/s2", depends=["force", "x"], derives="v", place=15),
    ],
}
HIGHEST = V("highest", "parameter", None, 3, "Integer")  # and the order of input derivatives they take
LATE = V("late", "parameter", None, 0, "Integer", place=1)  # 1: slopes are NaN before the first step
RAMP = [V("ramp", "parameter", "m/s", 0.0), V("bend", "parameter", "s", 0.0)]  # of a source, from a corner on
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
    "bent": [
        V("u", "input", "m", 0.0),
        V("w", "input", "m", 0.0),
        V("y", "output", "m", depends=["u", "w"]),
        V("factor", "parameter", None, 1.0),
        V("bend", "parameter", None, 0.0),
    ],
    "fails": [
        V("u", "input", None, 0.0),
        V("y", "output"),
        V("when", "parameter", None, 1e9),
        V("how", "parameter", None, 0, "Integer"),
    ],
    "drift": [
        V("u", "input", "m", 0.0),
        V("u_rate", "input", "m/s", 0.0, derives="u"),
        V("y", "output"),
    ],
    "glide": [
        V("position", "input", "m", 0.0),
        V("velocity", "input", "m/s", 0.0, derives="position"),
        V("acceleration", "input", "m/s2", 0.0, derives="velocity"),
        V("y", "output"),
    ],
    "quirk": [
        V("u", "input", None, 0.0),
        V("y", "output"),
        V("gain", "parameter", None, 1.0),
        V("push", "parameter", None, 0.0),
        V("when", "parameter", None, 1e9),
        V("longest", "parameter", None, 0.0),
        V("u_rate", "input", None, 0.0, derives="u"),
        V("how", "parameter", None, 0, "Integer"),
        V("where", "parameter", None, 0, "Integer"),
        V("highest", "parameter", None, 3, "Integer"),
        V("even", "parameter", None, 0, "Integer"),
        V("mute", "parameter", None, -1, "Integer"),
    ],
    "single": [  # QUIRK in FMI 3.0 with single precision only
        V("u", "input", None, 0.0, "Float32"),
        V("y", "output", None, kind="Float32"),
        V("gain", "parameter", None, 1.0, "Float32"),
        V("push", "parameter", None, 0.0, "Float32"),
        V("when", "parameter", None, 1e9, "Float32"),
        V("longest", "parameter", None, 0.0, "Float32"),
        V("u_rate", "input", None, 0.0, "Float32", derives="u"),
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
        V("resources", "output", None, kind="String"),
    ],
    "wide": [  # FMI 3.0 only
        V("float32_in", "input", "m", 0.0, "Float32"),
        V("float32_out", "output", "m", kind="Float32", depends=["float32_in"]),
        *(
            v
            for kind in WIDTHS
            for v in (
                V(f"{kind.lower()}_in", "input", None, 0, kind),
                V(f"{kind.lower()}_out", "output", None, kind=kind, depends=[f"{kind.lower()}_in"]),
            )
        ),
        V("size", "structuralParameter", None, 3, "UInt64"),
        V("size_out", "output", None, kind="UInt64"),
    ],
}


@cache
def _library() -> bytes:
    """All models, for this machine; hidden, because the C library has a function `advance`, too."""
    header = Path(__file__).with_name("models.h")
    return library("any_fmu", SOURCES, "-std=c99", "-fvisibility=hidden", included=[header])


@dataclass
class Workshop:
    """Makes FMUs of the models in `folder`, for one version of FMI."""

    folder: Path
    fmi: int = 2
    library: bytes = field(default_factory=_library)
    _made: dict[str, Path] = field(default_factory=dict)

    def other(self, fmi: int) -> Workshop:
        """A workshop for another version of FMI, in a folder inside this one's."""
        folder = self.folder / f"fmi{fmi}"
        folder.mkdir()
        return Workshop(folder, fmi, self.library)

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
        version: str | None = None,
        kind: str = "CoSimulation",
        guid: str | None = None,
        interpolates: bool = False,
        extra: Mapping[str, str] | None = None,
        more: str = "",
        experiment: str = "",
        aliases: Mapping[str, str] | None = None,
        able: Mapping[str, object] | None = None,
        changes: Mapping[str, Mapping[str, object]] | None = None,
        also: Sequence[V] = (),
    ) -> Path:
        """An FMU that differs from the plain one.

        units        variable -> other unit
        undeclared   leave out all dependencies
        platform     folder of the binary; "" for none
        extra        file in the archive -> content
        more         XML of more variables
        experiment   attributes of DefaultExperiment
        aliases      variable -> its other name, in FMI 3.0
        able         attributes of the element CoSimulation that differ from those in `ABLE`
        changes      variable -> what is different about its `V`
        also         variables that the plain one does not show
        """
        name = name or model
        path = self.folder / f"{name}.fmu"
        changed = {name: {"unit": unit} for name, unit in (units or {}).items()} | dict(changes or {})
        variables = [replace(v, **changed.get(v.name, {})) for v in [*MODELS[model], *also]]
        abilities = (
            {**ABLE[self.fmi]} | ({"canInterpolateInputs": "true"} if interpolates else {}) | (able or {})
        )
        told = "".join(f' {k}="{x}"' for k, x in abilities.items()) if kind == "CoSimulation" else ""
        head = Head(name, guid or model, version or f"{self.fmi}.0", kind, undeclared, told, experiment)
        if self.fmi == 2:
            text = describe2(head, variables, more)
        else:
            text = describe3(head, variables, more, aliases or {})
        usual = fmpy.platform if self.fmi == 2 else fmpy.platform_tuple
        where = usual if platform is None else platform
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", text)
            if where:
                archive.writestr(f"binaries/{where}/{name}{fmpy.sharedLibraryExtension}", self.library)
            for member, content in (extra or {}).items():
                archive.writestr(member, content)
        return path


TELLS = {2: "providesDirectionalDerivative", 3: "providesDirectionalDerivatives"}
DEPENDS = {"force": ["x2", "x"], "x": ["x"], "v": ["v"]}


def telling(workshop: Workshop, model: str, name: str | None = None, **more: object) -> Path:
    """A mass that declares its states and has directional derivatives of states and outputs."""
    outputs = ("force", "x", "v") if model == "mass_a" else ("x", "v")
    given = {
        "interpolates": workshop.fmi == 2,
        "able": {TELLS[workshop.fmi]: "true"},
        "also": STATES[model],
        "changes": {y: {"depends": DEPENDS[y]} for y in outputs},
    }
    return workshop.make(model, name or f"{model}_tells", **given | more)


def oscillator_of(a: Path, b: Path) -> System:
    """Two masses and three springs."""
    return assemble({"a": a, "b": b}, ["a.force -> b.force", "b.x -> a.x2"])


@dataclass(frozen=True)
class Head:
    """What a description says about the whole FMU."""

    name: str
    guid: str
    version: str
    kind: str
    undeclared: bool
    able: str
    experiment: str


def describe2(head: Head, variables: list[V], more: str) -> str:
    """modelDescription.xml of FMI 2.0; dependencies are indices, references start at 0 for each type."""
    index = {v.name: str(i + 1) for i, v in enumerate(variables)}
    outputs = [v for v in variables if v.causality == "output"]
    rates = [v for v in variables if v.causality == "local" and v.derives]
    unknowns, states = (
        "".join(f'<Unknown index="{index[v.name]}"{_on(v, index, head)}/>' for v in group)
        for group in (outputs, rates)
    )
    derivatives = f"<Derivatives>{states}</Derivatives>" if states else ""
    lines = [_scalar2(v, reference % 100, index) for v, reference in _references(variables)]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{head.version}" modelName="{head.name}" guid="{head.guid}">
<{head.kind} modelIdentifier="{head.name}"{head.able}/>
{_units(variables)}
<TypeDefinitions><SimpleType name="Colour"><Enumeration>{ITEMS}</Enumeration></SimpleType></TypeDefinitions>
{CATEGORIES}
<DefaultExperiment {head.experiment}/>
<ModelVariables>{"".join(lines)}{more}</ModelVariables>
<ModelStructure><Outputs>{unknowns}</Outputs>{derivatives}
<InitialUnknowns>{unknowns}{states}</InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""


def describe3(head: Head, variables: list[V], more: str, aliases: Mapping[str, str]) -> str:
    """modelDescription.xml of FMI 3.0; dependencies are references, unique over all types."""
    place = {v.name: str(reference) for v, reference in _references(variables)}
    outputs = [v for v in variables if v.causality == "output"]
    unknowns = [f'valueReference="{place[v.name]}"{_on(v, place, head)}' for v in outputs]
    rates = [v for v in variables if v.causality == "local" and v.derives]
    states = [f'valueReference="{place[v.name]}"{_on(v, place, head)}' for v in rates]
    structure = [f"<Output {u}/>" for u in unknowns]
    structure += [f"<ContinuousStateDerivative {u}/>" for u in states]
    structure += [f"<InitialUnknown {u}/>" for u in [*unknowns, *states]]
    lines = [_scalar3(v, place, aliases.get(v.name)) for v in variables]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{head.version}" modelName="{head.name}" instantiationToken="{head.guid}">
<{head.kind} modelIdentifier="{head.name}"{head.able}/>
{_units(variables)}
<TypeDefinitions><EnumerationType name="Colour">{ITEMS}</EnumerationType></TypeDefinitions>
{CATEGORIES}
<DefaultExperiment {head.experiment}/>
<ModelVariables>{"".join(lines)}{more}
<Float64 name="time" valueReference="300" causality="independent" variability="continuous"/></ModelVariables>
<ModelStructure>{"".join(structure)}</ModelStructure>
</fmiModelDescription>
"""


YES = "true"
ABLE: Mapping[int, Mapping[str, object]] = {
    2: {
        **dict.fromkeys(("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate"), YES),
        **{"canSerializeFMUstate": YES, "maxOutputDerivativeOrder": 1},
    },
    3: {
        **dict.fromkeys(("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState"), YES),
        **{"canSerializeFMUState": YES, "maxOutputDerivativeOrder": 1},
        "providesDirectionalDerivatives": YES,
    },
}
ITEMS = '<Item name="red" value="1"/><Item name="green" value="2"/>'
CATEGORIES = """<LogCategories><Category name="logStatusWarning"/><Category name="logStatusError"/>
</LogCategories>"""
NAMES3 = {"Real": "Float64", "Integer": "Int32"}


def _references(variables: list[V]) -> list[tuple[V, int]]:
    """Reals from 0, whole numbers from 100, texts from 200, each in order."""
    following = {"Real": 0, "Whole": 100, "String": 200}
    found = []
    for v in variables:
        family = {"Float32": "Real"}.get(v.kind, v.kind if v.kind in following else "Whole")
        found.append((v, following[family] if v.place is None else v.place))
        following[family] += v.place is None
    return found


def _on(v: V, place: Mapping[str, str], head: Head) -> str:
    """The dependencies of an output, as an attribute."""
    if head.undeclared or v.depends is None:
        return ""
    return f' dependencies="{" ".join(place[d] for d in v.depends)}"'


def _attributes(v: V, place: Mapping[str, str]) -> str:
    start = v.start if v.causality not in ("output", "local") and v.kind != "String" else None
    attributes = {"unit": v.unit, "start": start}
    if v.kind == "Enumeration":
        attributes["declaredType"] = "Colour"
    if v.derives:
        attributes["derivative"] = place[v.derives]
    return "".join(f' {k}="{x}"' for k, x in attributes.items() if x is not None)


def _steady(v: V) -> str:
    """The variability."""
    if v.steady:
        return v.steady
    real = v.kind in ("Real", "Float32")
    fixed = v.causality in ("parameter", "structuralParameter")
    return "fixed" if fixed else "continuous" if real else "discrete"


def _scalar2(v: V, reference: int, index: Mapping[str, str]) -> str:
    text = f' start="{v.start}"' if v.kind == "String" and v.start is not None else ""
    return (
        f'<ScalarVariable name="{v.name}" valueReference="{reference}" causality="{v.causality}" '
        f'variability="{_steady(v)}"><{v.kind}{_attributes(v, index)}{text}/></ScalarVariable>'
    )


def _scalar3(v: V, place: Mapping[str, str], alias: str | None) -> str:
    kind = NAMES3.get(v.kind, v.kind)
    inner = f'<Alias name="{alias}"/>' if alias else ""
    inner += f'<Start value="{v.start}"/>' if v.kind == "String" and v.start is not None else ""
    return (
        f'<{kind} name="{v.name}" valueReference="{place[v.name]}" causality="{v.causality}" '
        f'variability="{_steady(v)}"{_attributes(v, place)}>{inner}</{kind}>'
    )


def _units(variables: list[V]) -> str:
    used = sorted({v.unit for v in variables if v.unit})
    return f"<UnitDefinitions>{''.join(map(_unit, used))}</UnitDefinitions>" if used else ""


def _unit(name: str) -> str:
    base = BASE[name]
    inner = "" if base is None else "<BaseUnit" + "".join(f' {k}="{x}"' for k, x in base.items()) + "/>"
    return f'<Unit name="{name}">{inner}</Unit>'
