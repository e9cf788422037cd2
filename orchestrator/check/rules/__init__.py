"""Rules that read the files of an FMU and do not run it."""

from pathlib import Path

from orchestrator.check.rule import rules_in
from orchestrator.check.rules import archive, identity, libraries, structure, units, variables

FILE = Path(__file__).with_name("rules.toml")
STATIC = rules_in(FILE, archive, identity, libraries, structure, units, variables)
