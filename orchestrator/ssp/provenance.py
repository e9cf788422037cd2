"""What ran: checksums of the files, and the values that differ from the shipped ones, with their origin.

An FMU knows the file of parameters that it was built with (`harvester build --parameters`) from an annotation
in its modelDescription.xml, see `ParameterSetFile`. A system knows the values that a user chose from
`Component.origins`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, archive_kept_open
from orchestrator.base.text import first_names
from orchestrator.base.units import in_reader_unit, reader_unit
from orchestrator.fmi.description import Value
from orchestrator.ssp.system import Component, Port, System, coerce


@dataclass(frozen=True)
class OtherValue:
    """A start value that differs from the shipped one.

    name      component.variable
    shipped   value of the shipped FMU or system; None if it has none
    origin    the file of parameters, the parameter set, or --set
    """

    name: str
    value: Value
    unit: str = ""
    shipped: Value | None = None
    origin: str = ""

    def __str__(self) -> str:
        """In words: "supply.pressure_setting is 190 bar"."""
        unit = reader_unit(self.unit)
        return f"{self.name} is {value_text(self.value, self.unit)} {'' if unit == '1' else unit}".rstrip()


def value_text(value: Value, unit: str) -> str:
    """A value in the unit of readers, six digits."""
    plain = isinstance(value, str | bool | int)
    return str(value) if plain else f"{in_reader_unit(float(value), unit):.6g}"


@dataclass(frozen=True)
class Provenance:
    """Files and values of a run.

    fmus     component -> file of its FMU, and SHA-256 of that file
    files    the other files: system, parameters, scenario -> SHA-256
    values   start values that differ from the shipped ones
    """

    fmus: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    values: tuple[OtherValue, ...] = ()

    @staticmethod
    def of(data: Mapping[str, Any]) -> Provenance:
        """From the JSON that `asdict` gives."""
        values = tuple(OtherValue(**value) for value in data.get("values", ()))
        return Provenance(data.get("fmus", {}), data.get("files", {}), values)


def provenance(system: System, files: Sequence[str | Path | Location] = ()) -> Provenance:
    """The provenance of a run of a system; files: others that the run read, such as that of the scenario."""
    sources = {name: c.source for name, c in system.components.items() if c.source is not None}
    with archive_kept_open():
        fmus = {name: {"file": str(fmu), "sha256": checksum(fmu)} for name, fmu in sources.items()}
    own = [Location(system.source.path)] if system.source else []
    others = [file if isinstance(file, Location) else Location(Path(file)) for file in files]
    built = {s.file: s.sha256 for c in system.components.values() for s in c.interface.model.parameter_sets}
    sums = {str(file): checksum(file) for file in (*own, *others)}
    return Provenance(fmus, sums | built, tuple(other_values(system)))


def other_values(system: System) -> Iterator[OtherValue]:
    """The start values that differ from the shipped ones: built into the FMU, or chosen by the user.

    Connected inputs are left out, because their start values have no effect after the initialisation.
    """
    connected = {c.target for c in system.connections}
    for component in system.components.values():
        variables = component.interface.variables
        built = _built(component)
        for name in dict.fromkeys([*built, *component.origins]):
            if name not in variables or Port(component.name, name) in connected:
                continue
            shipped: Value | None = built[name][0] if name in built else component.origins[name].before
            value = component.value(name)
            if value == shipped or value != value:
                continue
            origin = component.origins[name].origin if name in component.origins else built[name][1]
            unit = variables[name].unit
            shipped = None if shipped != shipped else shipped
            yield OtherValue(f"{component.name}.{name}", value, unit.name if unit else "", shipped, origin)


def _built(component: Component) -> dict[str, tuple[Value, str]]:
    """Parameter -> value in the shipped FMU and file of the value that replaces it."""
    result: dict[str, tuple[Value, str]] = {}
    for parameter_set in component.interface.model.parameter_sets:
        for name, text in parameter_set.shipped.items():
            if variable := component.interface.variables.get(name):
                with suppress(Problem):  # an annotation that another tool has changed
                    result[name] = coerce(name, variable, text), parameter_set.file
    return result


def built_notes(system: System) -> tuple[str, ...]:
    """A line for each file of parameters that FMUs of the system were built with."""
    counts = Counter(file for c in system.components.values() for _, file in _built(c).values())
    home = system.source.path if system.source else system.name
    verb = f"{home} was" if len(system.components) == 1 else f"the FMUs in {home} were"
    differ = ((file, f"{n} parameter{'s differ' if n > 1 else ' differs'}") for file, n in counts.items())
    told = "from the shipped ones; harvester parameters shows them"
    return tuple(f"{verb} built with {file}: {number} {told}" for file, number in differ)


def chosen_note(system: System) -> str:
    """The first values that a user chose, in words; empty if there are none."""
    built = {f"{c.name}.{name}" for c in system.components.values() for name in _built(c)}
    return first_names((str(v) for v in other_values(system) if v.name not in built), limit=3)


def checksum(file: Location) -> str:
    """The SHA-256 of a file, a member of an archive or a folder; empty if it cannot be read."""
    try:
        return file.kept_sha256
    except (OSError, Problem):
        return ""  # what cannot be read is told by the run itself
