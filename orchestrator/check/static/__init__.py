"""Rules that read the FMU and run nothing of it."""

from __future__ import annotations

from orchestrator.check.finding import Rule
from orchestrator.check.static import (
    abilities,
    archive,
    contents,
    defaults,
    description,
    exports,
    identity,
    libraries,
    names,
    platforms,
    python,
    sources,
    structure,
    terminals,
    units,
    values,
    variables,
)

MODULES = (
    archive,
    description,
    identity,
    structure,
    variables,
    values,
    units,
    names,
    platforms,
    exports,
    libraries,
    python,
    abilities,
    defaults,
    contents,
    sources,
    terminals,
)
STATIC: tuple[Rule, ...] = tuple(rule for module in MODULES for rule in module.RULES)
