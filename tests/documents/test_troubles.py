"""The page of troubles quotes messages that the program can print."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/troubles.md").read_text(encoding="utf-8")
OF_OTHERS = ("command not found",)  # of the shell
TEXTS = "\n".join(
    re.sub(r'"\s*\n\s*f?"|%\S*\w', "", path.read_text(encoding="utf-8"))  # one text over several lines
    for folder in ("orchestrator", "fmus")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in (".py", ".c", ".h", ".inc", ".js", ".j2")
)
QUOTED = [
    text for line in PAGE.splitlines() if line.startswith("###") for text in re.findall("`(.+?)`", line)
]


@pytest.mark.parametrize("message", [m for m in QUOTED if " " in m and not m.endswith(OF_OTHERS)])
def test_a_quoted_message_exists(message: str) -> None:
    """Each part between its gaps is in a text of the program."""
    parts = [part.strip(" ;:,=?") for part in message.replace('"', "").split("\N{HORIZONTAL ELLIPSIS}")]
    assert len(QUOTED) > 18, "most headings quote one"
    assert [part for part in parts if part and part not in TEXTS] == []
