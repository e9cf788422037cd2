"""How the harvester is driven, as its own description says."""

from __future__ import annotations

from pathlib import Path

from fmus.machine.ssp import VIEW
from orchestrator.base.toml import read, read_dataclass
from orchestrator.scene.view_description import ViewDescription

DESCRIPTION = read_dataclass(ViewDescription, read(Path(VIEW), VIEW.read_bytes()))
MODES = DESCRIPTION.modes
