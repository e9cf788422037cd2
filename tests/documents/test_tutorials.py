"""The tutorials do what they say: every command and snippet is run, every output shown is what comes."""

import contextlib
import re
import shutil
import tomllib
from pathlib import Path

import pytest
from kit import shards, tutorial
from kit.mistakes import table
from kit.tutorial import Page

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


@table(__file__, "marks", "text, fault")
def test_a_page_runs_what_is_not_marked(tmp_path, text, fault):
    """Indented commands are run and compared; a mark holds for the next block, or for one line of it."""
    (tmp_path / "a.md").write_text(text)
    with contextlib.nullcontext() if not fault else pytest.raises(AssertionError, match=fault):
        tutorial.Page(tmp_path / "a.md", tmp_path).run()


# ---- What the pages print is what runs: each command and each block of Python, in order, in one folder

FOLDERS = ("docs/tutorials", "docs", "examples/*", "fmus", "fmus/*", "orchestrator")
FILES = (ROOT / "README.md", *(p for folder in FOLDERS for p in ROOT.glob(f"{folder}/*.md")))
NAMES = sorted(str(p.relative_to(ROOT)) for p in FILES)
PAGES = [name for name in NAMES if any(True for _ in Page(ROOT / name, ROOT).units())]
ABRIDGED = [n for n in PAGES if n.startswith("docs/tutorials") and "```shell" in (ROOT / n).read_text()]
PLAIN = [name for name in PAGES if name not in ABRIDGED]
QUICK = {"fmus/swing/README.md", "fmus/boom_stick/README.md", "orchestrator/README.md"}
# what the Python of a page leaves: names, and as `printed` the output of the last block
LEFT = {
    "README.md": "printed.endswith('boom_stick.boom_rod_pressure\\n')",
    "docs/run.md": "'pass: 146 of 146 signals' in printed",
    "docs/coupling.md": "float(printed) < 1e-4",  # of range, with the tolerance 1e-6 of hermite
    "docs/linearize.md": "plant.nstates == 20 and poles.real.max() < 0",  # the regulator keeps what it is for
}
MOST = 0.1  # share of commands and blocks that a page may leave out


@pytest.fixture
def copy(built, tmp_path):
    """A folder like the project's root after `harvester build`, which the commands may write into."""
    for name in ("data", "docs", "examples", "benchmarks"):
        shutil.copytree(ROOT / name, tmp_path / name)
    shutil.copytree(built, tmp_path / "build")
    return tmp_path


@pytest.mark.parametrize("page", shards.few(QUICK, PLAIN, shards.documents))
def test_a_page_runs_as_printed(page, copy):
    """Commands end with status 0, or as printed; text right after them is what they print."""
    reader = Page(ROOT / page, copy)
    reader.run()
    assert eval(LEFT.get(page, "True"), {**reader.names, "printed": reader.printed}), reader.printed


def test_little_is_left_out():
    """At most a tenth is marked as not run here, each with its reason; prints how many."""
    units = [(name, *unit) for name in PAGES for unit in Page(ROOT / name, ROOT).units()]
    left = [f"{name}:{line}: {text.splitlines()[0]} ({why})" for name, line, _, text, why in units if why]
    print(*left, f"{len(left)} of {len(units)} commands and blocks are not run", sep="\n")
    assert len(left) <= MOST * len(units), left


@shards.documents
def test_examples_of_the_help_run(copy):
    """An indented command in the text of `--help` runs as it is."""
    texts = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "orchestrator/cli").glob("*.py"))
    examples = re.findall(r"^ {4}(harvester .*)$", texts, re.MULTILINE)
    assert examples
    for example in examples:
        Page(ROOT / "README.md", copy).command(example)


# ---- The documents: links lead somewhere, names exist

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
