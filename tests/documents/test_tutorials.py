"""The tutorials do what they say: every command and snippet is run, every output shown is what comes."""

import contextlib
from pathlib import Path

import pytest
from kit import shards, tutorial
from kit.mistakes import table

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted(p for p in (ROOT / "docs" / "tutorials").glob("*.md") if p.stem != "index")


@shards.documents
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda p: p.stem)
def test_a_tutorial_runs_as_printed(path, workplace):
    """Block after block, in a fresh folder."""
    tutorial.Tutorial(path, workplace).run()


def test_the_list_of_tutorials_is_complete():
    """Each has a line in the list."""
    text = (ROOT / "docs" / "tutorials" / "index.md").read_text(encoding="utf-8")
    assert TUTORIALS
    assert [p.name for p in TUTORIALS if f"({p.name})" not in text] == []


@table(__file__, "outputs", "shown, printed, same")
def test_shown_output_is_compared(shown, printed, same):
    """Words must be equal, numbers near, and only `...` stands for anything."""
    assert (not tutorial.difference(shown, printed)) == same


def test_a_block_that_fails_is_told(tmp_path):
    """A wrong output, a command's wrong status and an unknown language name the line."""
    for block in ("```shell\nexit 3\n```", "```python\nprint(1)\n```\n```text\n2\n```", "```ruby\n1\n```"):
        (tmp_path / "a.md").write_text(f"# A\n\n{block}\n")
        with pytest.raises(AssertionError, match=r"a\.md:\d"):
            tutorial.Tutorial(tmp_path / "a.md", tmp_path).run()
    (tmp_path / "a.md").write_text("```shell\nexit 3 # status 3\n```\n")
    tutorial.Tutorial(tmp_path / "a.md", tmp_path).run()


def test_a_page_runs_what_is_not_marked(tmp_path):
    """Indented commands are run and compared; a mark holds for the next block, or for one line of it."""
    page = tmp_path / "a.md"
    for text, fault in (
        ("    python -c 'print(1)'\n\n```text\n1\n```\n", ""),
        ("    python -c 'print(1)'\n\n```text\n2\n```\n", "2 is shown"),
        ("<!-- not run: never ends -->\n\n    python -c 'exit(1)'\n", ""),
        ("<!-- not run: never ends -->\n\nText.\n\n    python -c 'exit(1)'\n", "status 1"),
        ("<!-- not run: `python -c 'x'`, no -->\n\n    python -c 'x'\n    python -c 'exit(1)'\n", "status 1"),
        ("<!-- not run: `make`, not there -->\n\n    python -c 'exit(0)'\n", "not there"),
        ("    python -c 'exit(1)'  # status 1: as it is\n", ""),
    ):
        page.write_text(text)
        with contextlib.nullcontext() if not fault else pytest.raises(AssertionError, match=fault):
            tutorial.Page(page, tmp_path).run()
