"""Rules that read the FMU and run nothing of it."""

from __future__ import annotations

from orchestrator.check.finding import Rule
from orchestrator.check.rules import archive, description, libraries, structure, units, variables

TABLES = (
    archive.ARCHIVE,
    description.DESCRIPTION_FILE,
    description.IDENTITY,
    structure.STRUCTURE,
    variables.VARIABLES,
    variables.VALUES,
    units.UNITS,
    variables.NAMES,
    libraries.PLATFORMS,
    libraries.EXPORTS,
    libraries.LIBRARIES,
    libraries.PYTHON,
    structure.CAPABILITIES,
    description.DEFAULT_EXPERIMENT,
    archive.CONTENTS,
    archive.SOURCES,
    units.TERMINALS,
)
STATIC: tuple[Rule, ...] = tuple(rule for table in TABLES for rule in table)
