"""What pages take from the program itself, in place of a mark such as `<!-- commands -->`."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

Row = Iterable[object]
ROOT = Path(__file__).parents[2]


def filled(markdown: str) -> str:
    """A page with its marks replaced."""
    for name, made in TABLES.items():
        mark = f"<!-- {name} -->"
        if mark in markdown:
            markdown = markdown.replace(mark, made())
    return markdown


def table(head: Row, rows: Iterable[Row]) -> Iterator[str]:
    """The lines of a table."""
    cells = [[str(cell).replace("|", "\\|").replace("\n", " ") for cell in row] for row in (head, *rows)]
    yield from (f"| {' | '.join(row)} |" for row in (cells[0], ["---"] * len(cells[0]), *cells[1:]))
    yield ""


@cache
def commands() -> str:
    """All commands with their arguments and options, as `--help` has them."""
    import typer

    from orchestrator.cli import app

    group: Any = typer.main.get_command(app)
    return "\n".join(line for name, command in group.commands.items() for line in _command(name, command))


def _command(name: str, command: Any) -> Iterator[str]:
    shown = [p for p in command.params if not getattr(p, "hidden", False) and p.name != "help"]
    words = [p for p in shown if p.param_type_name == "argument"]
    arguments = [_word(p) if p.required else f"[{_word(p)}]" for p in words]
    yield f"## {name}\n\n{command.help}\n"
    yield f"```text\nharvester {' '.join([name, *arguments, '[OPTIONS]'])}\n```\n"
    rows = [(f"`{_option(p)}`", p.help or "", _usual(p)) for p in shown]
    yield from table(("", "", "default"), rows) if rows else ()


def _word(parameter: Any) -> str:
    return parameter.metavar or parameter.name.upper()


def _option(p: Any) -> str:
    if p.param_type_name == "argument":
        return _word(p)
    names = " / ".join([*p.opts, *p.secondary_opts])
    return names if p.is_flag else f"{names} {p.metavar or p.type.name.upper()}"


def _usual(p: Any) -> str:
    if p.required:
        return "required"
    none = p.default is None or p.default == () or p.default == "" or callable(p.default)
    if none or (getattr(p, "is_flag", False) and not p.secondary_opts):
        return ""
    if getattr(p, "is_flag", False):
        return f"`{p.opts[0] if p.default else p.secondary_opts[0]}`"
    return f"`{p.default}`"


def _subsystems() -> list[Any]:
    from fmus.machine.parts import FAMILIES
    from fmus.operator_input import OPERATOR

    return [*(sub for family in FAMILIES.values() for sub in family.values()), OPERATOR]


@cache
def variants() -> str:
    """The variants of each part."""
    from fmus.contract import quantities
    from fmus.machine.parts import FAMILIES

    lines = []
    for part, family in FAMILIES.items():
        lines += [f"## {part}", ""]
        rows = [
            (f"`{v}`", sub.text, sub.validity, *(len(quantities(g)) for g in (sub.states, sub.parameters)))
            for v, sub in family.items()
        ]
        lines += table(("variant", "what it is", "holds for", "states", "parameters"), rows)
    return "\n".join(lines)


@cache
def ports() -> str:
    """Inputs and outputs of each part; of a variant what it has more."""
    from fmus.contract import quantities

    lines, known = [], dict[str, set[str]]()
    for sub in _subsystems():
        groups = ("input", quantities(sub.inputs)), ("output", quantities(sub.outputs))
        seen = known.setdefault(sub.component, set())
        rows = [
            (f"`{name}`", kind, q.unit, q.text, f"rate of `{_fed(group, name)}`" if _fed(group, name) else "")
            for kind, group in groups
            for name, q in group.items()
            if name not in seen
        ]
        if rows:
            more = " has more" if seen else ""
            lines += [f"## {sub.name}{more}", "", sub.text, ""]
            lines += table(("name", "", "unit", "meaning", ""), rows)
        seen.update(name for _, group in groups for name in group)
    return "\n".join(lines)


def _fed(group: Any, name: str) -> str:
    return next((other for other, q in group.items() if q.rate == name), "")


@cache
def parameters() -> str:
    """Every number with unit and source; of a variant what the usual one does not have."""
    from fmus.contract import quantities
    from fmus.parameters import numbers, row_text, row_value
    from fmus.parameters import rows as rows_of

    lines, known = [], dict[str, set[str]]()
    for sub in _subsystems():
        declared = quantities(sub.parameters) | quantities(sub.inputs) | quantities(sub.states)
        seen = known.setdefault(sub.component, set())
        rows = []
        for section, entries in numbers(sub).items():
            for name, row in rows_of(entries).items():
                if (key := f"{section}.{name}") not in seen:
                    seen.add(key)
                    n, text = row[0], row_text(name, declared)
                    start = " (start)" if section == "start" else ""
                    told = f"{text}. {n.note}" if n.note else text
                    value = row_value(name, row, lambda n: f"{n.value:.6g}")
                    rows.append((f"`{name}`{start}", value, n.unit, n.source, told))
        if rows:
            more = "" if sub.name == sub.component else " has more"
            lines += [f"## {sub.name}{more}", "", *table(("name", "value", "unit", "source", ""), rows)]
    return "\n".join(lines)


@cache
def sources() -> str:
    """The words of the column `source`."""
    from fmus.parameters import SOURCES

    return "\n".join(table(("source", "meaning"), ((f"`{word}`", text) for word, text in SOURCES.items())))


@cache
def rules() -> str:
    """The rules of `harvester check`, by topic."""
    from orchestrator.check.checking import RULES
    from orchestrator.check.report import table as rule_table

    return rule_table(RULES)


@cache
def public_names() -> dict[str, list[str]]:
    """Where an object is defined -> its names in the packages that have `__all__`, as orchestrator.run."""
    names: dict[str, list[str]] = {}
    for file in sorted([*ROOT.glob("fmus/**/__init__.py"), *ROOT.glob("orchestrator/**/__init__.py")]):
        package = ".".join(file.relative_to(ROOT).parent.parts)
        if "\n__all__ = " in file.read_text(encoding="utf-8") and package != "orchestrator.cli":
            module = importlib.import_module(package)
            for name in module.__all__:
                found, public = getattr(module, name), f"{package}.{name}"
                inside = inspect.isclass(found) or inspect.isroutine(found)
                inside = inside and found.__module__ != "typing"
                place = f"{found.__module__}.{found.__qualname__}" if inside else public
                names.setdefault(place, []).append(public)
    return names


TABLES: dict[str, Callable[[], str]] = {
    "commands": commands,
    "variants": variants,
    "ports": ports,
    "parameters": parameters,
    "sources": sources,
    "rules": rules,
}
