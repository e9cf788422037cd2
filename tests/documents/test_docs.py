"""The documents: links lead somewhere, commands and snippets run as printed, names exist."""

import contextlib
import io
import re
import tomllib
from pathlib import Path

import pytest
from kit import shards
from kit.tutorial import Tutorial, blocks

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    p for p in ROOT.rglob("*.md") if not {".venv", "build", "node_modules"} & set(p.relative_to(ROOT).parts)
)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_relative_links_lead_to_files(document):
    """Every link that is not on the web names a file of the project."""
    text = document.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if not link.startswith(("http", "#", "mailto:")):
            assert (document.parent / link.split("#")[0]).exists(), link


# part of a command that is not run here, and why
ELSEWHERE = {
    "my_": "files of the reader; docs/tutorials/measurements.md has its own",
    "my.ssp": "a file of the reader",
    "rig --out": "minutes; tests/identification/test_command.py",
    "--platform all": "five platforms; tests/export/test_platforms.py",
    "harvester view": "does not end by itself; tests/view",
    "harvester sweep": "640 runs; tests/sweep/test_study_docs.py",
}
PAGES = ("README.md", "docs/run.md", "docs/coupling.md", "docs/control.md", "docs/machine.md")


@shards.documents
@pytest.mark.parametrize("page", PAGES)
def test_commands_of_a_page_run_as_printed(page, workplace):
    """In their order in one folder: what one writes the next ones read. The status is 0 or as printed."""
    text = (ROOT / page).read_text(encoding="utf-8")
    lines = re.findall(r"^    (harvester .*?)(?:\s+#(.*))?$", text, re.MULTILINE)
    reader, left = Tutorial(ROOT / page, workplace), []
    for line, comment in lines:
        status = re.search(r"status (\d)", comment)
        if any(word in line for word in ELSEWHERE):
            left.append(line)
        else:
            reader.command(f"{line} # status {status[1]}" if status else line)
    assert len(left) < len(lines)
    print(f"{page}: {len(lines) - len(left)} commands run, {len(left)} elsewhere")


# page -> what its snippets leave: `printed`, and the names that they define
LEFT = {
    "README.md": "'6 s simulated' in printed and printed.endswith('boom_stick.stick_rod_pressure\\n')",
    "docs/run.md": "'pass: 27 of 27 signals' in printed and '\\nboom_stick.boom_head_pressure\\n' in printed",
    # of range, with the tolerance 1e-6 of hermite
    "docs/coupling.md": "'master hermite, tolerance 0.0001' in printed and float(printed.split()[-1]) < 1e-4",
    "docs/linearize.md": "plant.nstates == 20 and poles.real.max() < 0",  # the regulator keeps what it is for
}


@pytest.mark.parametrize(
    "page", ["README.md", *(pytest.param(page, marks=shards.documents) for page in [*LEFT][1:])]
)
def test_the_python_snippets_of_a_page_run(page, workplace):
    """One after the other, as a reader would type them; they print and define what the page says."""
    names, printed = dict[str, object](), io.StringIO()
    with contextlib.chdir(workplace), contextlib.redirect_stdout(printed):
        for _, info, text in blocks(ROOT / page):
            if info.startswith("python"):
                exec(compile(text, page, "exec"), names)
    assert eval(LEFT[page], names | {"printed": printed.getvalue()}), printed.getvalue()


def test_signals_of_the_mapping_example_exist(system):
    """The measurement in docs/recordings.md maps columns to signals of this machine."""
    text = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
    examples = [tomllib.loads(t) for t in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]
    (signals,) = [example["signals"] for example in examples if "experiment" not in example]
    assert signals
    assert set(signals) <= set(system.names())
