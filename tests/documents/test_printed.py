"""What the pages print is what runs: each command and each block of Python, in order, in one folder."""

import re
import shutil
from pathlib import Path

import pytest
from kit import shards
from kit.tutorial import Page

ROOT = Path(__file__).parents[2]
FOLDERS = ("docs/tutorials", "docs", "examples/*", "fmus", "fmus/*", "orchestrator")
FILES = (ROOT / "README.md", *(p for folder in FOLDERS for p in ROOT.glob(f"{folder}/*.md")))
NAMES = sorted(str(p.relative_to(ROOT)) for p in FILES)
PAGES = [name for name in NAMES if any(True for _ in Page(ROOT / name, ROOT).units())]
TUTORIALS = [n for n in PAGES if n.startswith("docs/tutorials") and "```shell" in (ROOT / n).read_text()]
PLAIN = [name for name in PAGES if name not in TUTORIALS]
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
