"""`harvester variants`, `parameters` and `signals`: lists of what the machine and a system contain."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, TypeAlias

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import require_system
from orchestrator.base.options import Kind, Swaps
from orchestrator.cli.options import BUILD, System, command, system_file

if TYPE_CHECKING:
    from orchestrator.base.units import DeclaredUnit
    from orchestrator.ssp.system import Component, Port
    from orchestrator.ssp.system import System as FmuSystem

Entry: TypeAlias = "tuple[str, DeclaredUnit | None, str]"  # name, unit, description
KINDS = ("input", "output", "parameter")
WIDTH = 100  # characters


@command
def variants(system: System = None, cost: bool = False, json: bool = False) -> bool:
    """List the variants of each part, with numbers of states and inputs, and the range of validity.

    system   System in which the cost of the variants is measured; default: build/harvester.ssp, else the one
             in the installed package.
    cost     Also measure the simulation time of each variant on this computer, a few seconds.
    json     Print the list as JSON.
    """
    require("model", "harvester variants")
    from fmus.machine.tables import variant_lines, variant_names, variant_rows

    if not cost:
        if system:
            raise Problem(f"variants {system}: a system is only read with --cost")
        if json:
            _print_json("variants", variant_rows({}))
            return True
        print("\n".join(variant_lines({})))
        print("To measure the cost of each variant on this computer: harvester variants --cost")
        return True
    from orchestrator.studies.variant_costs import costs

    measured = costs(require_system(system_file(system)), variant_names())
    if json:
        _print_json("variants", variant_rows(measured))
    else:
        print("\n".join(variant_lines(measured)))
    return True


@command
def parameters(
    subsystem: Annotated[str | None, Kind(positional=True)] = None,
    source: Annotated[str | None, Kind("SOURCE")] = None,
    json: bool = False,
) -> None:
    """Print the parameters of the model with value, unit and source.

    If FMUs in the folder build were built with other values, prints these and the shipped values.

    subsystem   A part or a variant of a part, such as swing or swing_detailed, or a part of the names of
                parameters, such as hose; default: the whole machine.
    source      Only parameters of this source: paper, derived, literature, assumed or identified; default:
                all.
    json        Print them as JSON.
    """
    require("model", "harvester parameters")
    from fmus.machine.tables import parameter_rows, parameter_text

    chosen = subsystem, source, BUILD
    if json:
        _print_json("parameters", parameter_rows(*chosen))
    else:
        print(parameter_text(*chosen))


@command
def signals(
    system: System = None,
    kind: Annotated[str | None, Kind("KIND")] = None,
    swap: Swaps | None = None,
    json: bool = False,
) -> None:
    """List the variables of a system with unit and description.

    kind   Only this kind: input, output or parameter; default: all.
    json   Print them as JSON.
    """
    from orchestrator.ssp.load import configured

    if kind not in (None, *KINDS):
        raise Problem(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    found = configured(require_system(system_file(system)), swap=swap)
    if json:
        _print_json("signals", rows(found, kind))
    else:
        print("\n".join(lines(found, kind)))


def _print_json(what: str, rows: Iterable[Mapping[str, object]]) -> None:
    """Print rows in the shape of all reports."""
    from orchestrator.results.report import Report

    found = list(rows)
    print(Report(what.capitalize(), f"{len(found)} {what}", [], {what: found}).json())


def rows(system: FmuSystem, kind: str | None) -> Iterator[dict[str, str | None]]:
    """Inputs of the system, then the variables of each FMU, as data; or one kind."""
    for causality in (k for k in KINDS if kind in (None, k)):
        entries = _inlets(system) if causality == "input" else []
        entries += [e for c in system.components.values() for e in _variables(system, c, causality)]
        for name, unit, text in dict.fromkeys(entries):
            yield {"name": name, "kind": causality, "unit": unit.name if unit else None, "text": text}


def lines(system: FmuSystem, kind: str | None = None) -> Iterator[str]:
    """Inputs and outputs of the system, then outputs, inputs and parameters of each FMU; or one kind."""
    single = len(system.components) == 1 and not system.inputs  # the table of its FMU has the same inputs
    if kind in (None, "input") and not single:
        yield from _table(f"{system.name}: inputs for --set and scenarios", _inlets(system))
    if kind in (None, "output"):
        outlets = system.outputs.values()
        outputs = [(o.name, o.unit, _description(system, o.source, f"from {o.source}")) for o in outlets]
        yield from _table(f"{system.name}: outputs of the system", outputs)
    for component in system.components.values():
        if kind is None and component.interface.model.get("description"):
            yield from textwrap.wrap(
                f"{component.name}: {component.interface.model.get('description')}", WIDTH
            )
            yield ""
        for causality in ("output", "input", "parameter"):
            if kind in (None, causality):
                yield from _table(f"{component.name}: {causality}s", _variables(system, component, causality))
        if kind is None and component.interface.unsupported:
            yield from textwrap.wrap(f"{component.name}: {component.interface.unsupported_note}", WIDTH)
            yield ""


def _description(system: FmuSystem, port: Port, connected: str) -> str:
    """The description of a variable and its connection."""
    return "; ".join(filter(None, [system.variable(port).description, connected]))


def _inlets(system: FmuSystem) -> list[Entry]:
    """Inputs of the system and component inputs without a source; description: that of the first target."""
    entries = []
    for inlet in (*system.inputs.values(), *system.open.values()):
        ports = [port for port, _ in inlet.targets]
        text = _description(system, ports[0], f"to {', '.join(map(str, ports))}") if ports else ""
        entries.append((inlet.name, inlet.unit, text))
    return entries


def _variables(system: FmuSystem, component: Component, causality: str) -> list[Entry]:
    """The variables of one component; a connected input also has its source."""
    from orchestrator.ssp.system import Port

    source = {c.target: f"from {c.source}" for c in system.connections}
    ports = [(Port(component.name, v.name), v.unit) for v in component.interface.of(causality)]
    return [(str(p), unit, _description(system, p, source.get(p, ""))) for p, unit in ports]


def _table(title: str, entries: list[Entry]) -> Iterator[str]:
    """A table with three columns; long descriptions are wrapped."""
    if not entries:
        return
    yield title
    name_width = max(len(name) for name, _, _ in entries)
    unit_width = max(len(unit.name) if unit else 1 for _, unit, _ in entries)
    room = max(WIDTH - name_width - unit_width - 6, 30)
    for name, unit, text in entries:
        first, *more = textwrap.wrap(text, room, break_on_hyphens=False) or [""]
        head = f"  {name:<{name_width}}  {unit.name if unit else '-':<{unit_width}}  "
        yield (head + first).rstrip()
        yield from (" " * len(head) + line for line in more)
    yield ""
