"""modelDescription.xml of FMI 2.0 or 3.0 from a table of variables, and the archive around it."""

import io
import tomllib
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import fmpy

Place = TypeVar("Place", Path, io.BytesIO)
BASE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
ITEMS = '<Item name="red" value="1"/><Item name="green" value="2"/>'
COLOUR = {
    2: f'<SimpleType name="Colour"><Enumeration>{ITEMS}</Enumeration></SimpleType>',
    3: f'<EnumerationType name="Colour">{ITEMS}</EnumerationType>',
}
TIME = '<Float64 name="time" valueReference="300" causality="independent" variability="continuous"/>'
NAMES3 = {"Real": "Float64", "Integer": "Int32"}


@dataclass(frozen=True)
class V:
    """One variable.

    depends    the variables that an output or derivative depends on; None leaves that undeclared
    derives    the variable whose time derivative this one is
    steady     its variability, where it is not the usual one
    place      its value reference, where that is not the next one
    exact      it has a start value as a state, `initial` of FMI
    indicates  it is an event indicator
    more       more attributes of its type
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
    exact: bool = False
    indicates: bool = False
    more: str = ""


def tables(file: str) -> dict[str, list[V]]:
    """Model -> its variables, from the TOML file beside a file of Python."""
    models = tomllib.loads(Path(file).with_suffix(".toml").read_text(encoding="utf-8"))
    return {model: [V(name, **rest) for name, rest in table.items()] for model, table in models.items()}


@dataclass(frozen=True)
class Description:
    """A model description.

    kinds        ModelExchange, CoSimulation, with their attributes
    token        GUID or instantiation token; None for the name
    undeclared   leaves out all dependencies
    initial      has a list of initial unknowns
    experiment   attributes of DefaultExperiment
    more         XML of more variables
    aliases      variable -> its other name, in FMI 3.0
    """

    name: str
    variables: Sequence[V]
    kinds: Mapping[str, Mapping[str, object]]
    token: str | None = None
    version: str | None = None
    undeclared: bool = False
    initial: bool = True
    categories: Sequence[str] = ()
    experiment: str = ""
    more: str = ""
    aliases: Mapping[str, str] | None = None

    def text(self, fmi: int) -> str:
        """The XML; FMI 2.0 names variables in it by their index, FMI 3.0 by their value reference."""
        references = _references(self.variables)
        place = {v.name: i if fmi == 2 else references[v.name] for i, v in enumerate(self.variables, 1)}
        outputs = [self._unknown(v, place, fmi) for v in self.variables if v.causality == "output"]
        rates = [v for v in self.variables if v.causality == "local" and v.derives]
        derivatives = [self._unknown(v, place, fmi) for v in rates]
        initial = [*outputs, *derivatives] if self.initial else []
        indicators = [self._unknown(v, place, fmi) for v in self.variables if v.indicates]
        if fmi == 2:
            token, lines = "guid", [_scalar2(v, references[v.name] % 100, place) for v in self.variables]
            groups = {"Outputs": outputs, "Derivatives": derivatives, "InitialUnknowns": initial}
            structure = "".join(_inside(n, (f"<Unknown {u}/>" for u in found)) for n, found in groups.items())
            count = {"numberOfEventIndicators": len(indicators)} if "ModelExchange" in self.kinds else {}
        else:
            token, count, aliases = "instantiationToken", {}, self.aliases or {}
            lines = [_scalar3(v, references, aliases.get(v.name)) for v in self.variables]
            if all(v.causality != "independent" for v in self.variables):
                lines.append(TIME)
            groups = {"Output": outputs, "ContinuousStateDerivative": derivatives, "InitialUnknown": initial}
            groups["EventIndicator"] = indicators
            structure = "".join(f"<{name} {u}/>" for name, found in groups.items() for u in found)
        head = {"fmiVersion": self.version or f"{fmi}.0", "modelName": self.name}
        head[token] = self.token or self.name
        kinds = (f"<{k}{_attributes({'modelIdentifier': self.name, **a})}/>" for k, a in self.kinds.items())
        enumerations = any(v.kind == "Enumeration" for v in self.variables)
        experiment = f"<DefaultExperiment {self.experiment}/>\n" if self.experiment else ""
        return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription{_attributes({**head, **count})}>
{"".join(kinds)}
{_inside("UnitDefinitions", map(_unit, sorted({v.unit for v in self.variables if v.unit})))}
{_inside("TypeDefinitions", [COLOUR[fmi]] * enumerations)}
{_inside("LogCategories", (f'<Category name="{name}"/>' for name in self.categories))}
{experiment}{_inside("ModelVariables", [*lines, self.more])}
<ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>
"""

    def _unknown(self, v: V, place: Mapping[str, int], fmi: int) -> str:
        """An unknown with its dependencies, as attributes."""
        unknown = {"index" if fmi == 2 else "valueReference": place[v.name]}
        if not (self.undeclared or v.depends is None or v.indicates):
            unknown["dependencies"] = " ".join(str(place[d]) for d in v.depends)
        return _attributes(unknown).strip()


def packed(path: Place, members: Mapping[str, bytes | str]) -> Place:
    """An archive in a file or in memory."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def member(fmi: int, name: str, platform: str | None = None) -> str:
    """The member that holds the library of an FMU, for this computer or another platform."""
    usual = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    return f"binaries/{platform or usual}/{name}{fmpy.sharedLibraryExtension}"


def _inside(element: str, content: Iterable[str]) -> str:
    """An element with content; nothing without."""
    text = "".join(content)
    return f"<{element}>{text}</{element}>" if text else ""


def _attributes(values: Mapping[str, object]) -> str:
    return "".join(f' {name}="{value}"' for name, value in values.items() if value is not None)


def _references(variables: Sequence[V]) -> dict[str, int]:
    """Reals from 0, whole numbers from 100, texts from 200, each in order; in FMI 2.0 all from 0."""
    following = {"Real": 0, "Whole": 100, "String": 200}
    found = {}
    for v in variables:
        family = {"Float32": "Real"}.get(v.kind, v.kind if v.kind in following else "Whole")
        found[v.name] = following[family] if v.place is None else v.place
        following[family] += v.place is None
    return found


def _common(v: V, reference: int) -> str:
    """What both versions have of a variable."""
    usual = {"name": v.name, "valueReference": reference, "causality": v.causality}
    return _attributes(usual | {"variability": _steady(v), "initial": "exact" if v.exact else None})


def _steady(v: V) -> str:
    """The variability."""
    if v.steady:
        return v.steady
    real = v.kind in ("Real", "Float32")
    fixed = v.causality in ("parameter", "structuralParameter")
    return "fixed" if fixed else "continuous" if real else "discrete"


def _typed(v: V, place: Mapping[str, int]) -> str:
    """The attributes that FMI 2.0 has in the element of the type."""
    values = {"unit": v.unit, "start": _start(v) if v.kind != "String" else None}
    values["declaredType"] = "Colour" if v.kind == "Enumeration" else None
    values["derivative"] = place[v.derives] if v.derives else None
    return _attributes(values) + f" {v.more}" * bool(v.more)


def _start(v: V) -> object:
    start = v.start if v.exact or v.causality not in ("output", "local") else None
    return str(start).lower() if isinstance(start, bool) else start


def _scalar2(v: V, reference: int, place: Mapping[str, int]) -> str:
    text = _attributes({"start": v.start}) if v.kind == "String" else ""
    return f"<ScalarVariable{_common(v, reference)}><{v.kind}{_typed(v, place)}{text}/></ScalarVariable>"


def _scalar3(v: V, place: Mapping[str, int], alias: str | None) -> str:
    kind = NAMES3.get(v.kind, v.kind)
    inner = f'<Alias name="{alias}"/>' if alias else ""
    inner += f'<Start value="{v.start}"/>' if v.kind == "String" and v.start is not None else ""
    return f"<{kind}{_common(v, place[v.name])}{_typed(v, place)}>{inner}</{kind}>"


def _unit(name: str) -> str:
    base = BASE[name] and f"<BaseUnit{_attributes(BASE[name])}/>"
    return f'<Unit name="{name}">{base or ""}</Unit>'
