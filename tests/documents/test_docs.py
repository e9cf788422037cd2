"""The documents: links lead somewhere, commands and snippets run, names exist."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from orchestrator import load
from orchestrator.__main__ import main

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    p for p in ROOT.rglob("*.md") if not {".venv", "build", "node_modules"} & set(p.relative_to(ROOT).parts)
)
README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "run.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_relative_links_lead_to_files(document):
    """Every link that is not on the web names a file of the project."""
    text = document.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if not link.startswith(("http", "#", "mailto:")):
            assert (document.parent / link.split("#")[0]).exists(), link


def commands() -> list[str]:
    """The `harvester` lines of README and docs/run.md, but those that need files of the user.

    Others have tests of their own: the build for all platforms (tests/export/test_platforms.py), the page,
    which does not end by itself (tests/view), and the study of 640 runs (tests/sweep/test_swing_peaks.py).
    """
    lines = re.findall(r"^    (harvester .*?)(?:\s+#.*)?$", README + GUIDE, re.MULTILINE)
    elsewhere = ("my_", "--platform all", "harvester view", "harvester sweep")
    return list(dict.fromkeys(line for line in lines if not any(word in line for word in elsewhere)))


@pytest.fixture
def workplace(fmu_dir, tmp_path, monkeypatch):
    """A folder like the project's root after `harvester build`."""
    (tmp_path / "build").mkdir()
    for file in fmu_dir.iterdir():
        (tmp_path / "build" / file.name).symlink_to(file)
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("workplace")
@pytest.mark.parametrize("command", commands())
def test_commands_of_the_documents_run(command):
    """Each line works as it stands in the documents, here over the first half second."""
    arguments = shlex.split(command)[1:]
    if arguments[0] in ("run", "validate"):
        arguments += ["--stop", "0.5"]  # the last one counts
    files = [word for word in arguments[1:] if word.endswith(".csv")]
    for trace in files if arguments[0] in ("compare", "plot") else ():
        assert main(["run", "--stop", "0.5", "--out", trace]) == 0
    assert main(arguments) == 0


@pytest.mark.usefixtures("workplace")
@pytest.mark.parametrize("text", [README, GUIDE], ids=["README.md", "docs/run.md"])
def test_the_python_snippet_runs(text):
    """The lines under "In Python"."""
    (snippet,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(snippet, "snippet.py", "exec"), {})


@pytest.mark.usefixtures("workplace")
@pytest.mark.parametrize("page", ["coupling.md", "linearize.md"])
def test_the_python_snippets_of_a_page_run(page):
    """One after the other, as a reader would type them."""
    text, names = (ROOT / "docs" / page).read_text(encoding="utf-8"), dict[str, object]()
    snippets = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert snippets
    for snippet in snippets:
        exec(compile(snippet, page, "exec"), names)


def test_signals_of_the_mapping_example_exist(fmu_dir):
    """The measurement in docs/recordings.md maps columns to signals of this machine."""
    text = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
    names = set(load(fmu_dir / "harvester.ssp").names())
    examples = [tomllib.loads(t) for t in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]
    (signals,) = [example["signals"] for example in examples if "experiment" not in example]
    assert signals
    assert set(signals) <= names
