"""Rules that read the files of an FMU and do not run it."""

from orchestrator.check.rule import CheckRule
from orchestrator.check.rules import archive, identity, libraries, structure, units, variables

TABLES = (
    archive.ARCHIVE,
    identity.DESCRIPTION_FILE,
    identity.IDENTITY,
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
    identity.DEFAULT_EXPERIMENT,
    archive.CONTENTS,
    archive.SOURCES,
    units.TERMINALS,
)
STATIC: tuple[CheckRule, ...] = tuple(rule for table in TABLES for rule in table)
