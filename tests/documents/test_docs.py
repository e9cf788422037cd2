"""The documents: links lead somewhere, names exist."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LEFT_OUT = {".venv", "build", "node_modules"}
DOCUMENTS = sorted(p for p in ROOT.rglob("*.md") if not LEFT_OUT & set(p.relative_to(ROOT).parts))


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_relative_links_lead_to_files(document):
    """Every link that is not on the web names a file of the project."""
    text = document.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if not link.startswith(("http", "#", "mailto:")):
            assert (document.parent / link.split("#")[0]).exists(), link


def test_signals_of_the_mapping_example_exist(system):
    """The measurements in docs/recordings.md map columns to signals of this machine."""
    text = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
    examples = [tomllib.loads(t) for t in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]
    signals = [name for example in examples if "experiment" not in example for name in example["signals"]]
    assert len(signals) >= 4
    assert set(signals) <= set(system.names())
