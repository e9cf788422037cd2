"""Every page that a command writes, in a browser: no error, and all its charts with their numbers."""

import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kit import shards
from kit.wait import LONG

from orchestrator import Trace, read_trace, write_trace
from orchestrator.__main__ import main
from orchestrator.cli import COMMANDS

pytestmark = shards.browser

RUN, SHORT = "run --stop 2 --step 0.002", "--scenario boom_up --stop 0.4"
# page -> command that writes it, from the runs a.csv and b.csv, a study, a recording with hot oil; charts
WRITTEN = {
    "report.html": (f"validate --monolithic {SHORT} --step 0.002 --out .", 20),
    "reference/report.html": ("validate --stop 1 --out reference", 20),
    "comparison.html": ("compare a.csv b.csv --out .", 6),
    "build/plot.html": ("plot a.csv b.csv", 4),
    "build/energy.html": ("energy a.csv b.csv", 2),
    "convergence/convergence.html": (
        f"convergence {SHORT} --steps 0.005,0.01 --masters hermite --repeats 1 --out convergence",
        2,
    ),
    "sweep/report.html": ("sweep study.toml --workers 1 --out sweep", 2),
    "diagnosis/diagnosis.html": ("diagnose hot.csv --fmu {fmu} --out diagnosis", 1),
    "machine.html": ("page --out machine.html", 0),
}
ELSEWHERE = {  # commands whose pages other tests open
    "identify": "test_pages.py, and its estimates in tests/identification",
    "view": "tests/view: a page that is served",
    "build": "documentation in FMUs, below",
}
# what writes tables, FMUs, files or pictures, and no page
TABLES = "crane modelica variants parameters signals check run reference linearize track rig describe"
STUDY = """
system = "build/harvester.ssp"
method = "saltelli"
runs = 16
stop = 0.1
step = 0.002
[factors]
"manipulator.head_mass" = { distribution = "uniform", minimum = 100, maximum = 400 }
"supply.pressure_setting" = { distribution = "uniform", minimum = 15e6, maximum = 20e6 }
[outputs]
peak = { signal = "boom_stick.boom_head_pressure", measure = "maximum", band = true }
"""
# texts that a canvas was asked to draw
LISTEN = """() => {
  const draw = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...at) {
    (this.canvas.texts ??= []).push(String(text));
    return draw.call(this, text, ...at);
  };
}"""
# of each plot: charts that the page describes, and the texts of each chart that is drawn
DRAWN = """() => [...document.querySelectorAll('.plot')].map(host => [
  JSON.parse(host.querySelector('script').textContent).charts.length,
  [...host.querySelectorAll('.uplot canvas')].map(c => [...new Set(c.texts ?? [])].filter(t => t.trim()))])"""


def pages(folder: Path, fmu: Path, built: Path) -> None:
    """The pages of all commands, and the documentation of the FMUs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        shutil.copytree(built, "build", ignore=shutil.ignore_patterns("*.run.json"))
        Path("study.toml").write_text(STUDY, encoding="utf-8")
        assert main([*f"{RUN} --out a.csv".split()]) == 0
        assert main([*f"{RUN} --swap boom_stick=detailed --out b.csv".split()]) == 0
        run = read_trace(Path("a.csv"))
        hot = {
            n: run[n]
            for n in run.signals
            if n.startswith("boom_stick.") and n.endswith(("pressure", "_command"))
        }
        hot["swing.swing_command"] = np.zeros_like(run.time)
        hot["oil_temperature"] = np.full_like(run.time, 390.0)
        write_trace(Trace(run.time, {n.rpartition(".")[2]: v for n, v in hot.items()}), Path("hot.csv"))
        for page, (command, _) in WRITTEN.items():
            Path(page).parent.mkdir(exist_ok=True)
            assert main(command.format(fmu=fmu).split()) in (0, 1), command
            assert Path(page).is_file(), command
        for file in sorted(Path("build").rglob("*.fmu")):
            with zipfile.ZipFile(file) as archive:
                for name in archive.namelist():
                    if name.endswith(".html"):
                        Path(f"{file.stem}-{Path(name).name}").write_bytes(archive.read(name))


def test_each_command_is_listed() -> None:
    """A new command is in one of the lists, so that its page is opened."""
    writing = {command.split()[0] for command, _ in WRITTEN.values()}
    lists = [writing, set(ELSEWHERE), set(TABLES.split())]
    assert set().union(*lists) == set(COMMANDS)
    assert sum(map(len, lists)) == len(COMMANDS)


def test_every_page_opens_without_error_and_with_all_charts(
    once: Any, fmu: Path, built: Path, chromium: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """A chart has numbers or words beside it; the last one of a figure has numbers below it, too."""
    folder = once("written_pages", lambda folder: pages(folder, fmu, built))
    context, told, faults = chromium.new_context(viewport={"width": 1100, "height": 900}), [], []
    context.add_init_script(f"({LISTEN})()")
    for file in sorted(folder.rglob("*.html")):
        name, page, errors = file.relative_to(folder).as_posix(), context.new_page(), list[str]()
        page.set_default_timeout(1e3 * LONG)
        page.on("pageerror", lambda error, errors=errors: errors.append(str(error)))
        page.on("console", lambda m, errors=errors: errors.append(m.text) if m.type == "error" else None)
        page.goto(file.as_uri())
        page.evaluate("document.querySelectorAll('details:has(.plot)').forEach(d => d.open = true)")
        page.wait_for_timeout(300 if page.locator(".plot").count() else 0)
        shown = page.evaluate(DRAWN)
        charts = sum(len(drawn) for _, drawn in shown)
        told.append(f"{name}: {charts} charts, errors {len(errors)}")
        faults += [f"{name}: {error}" for error in errors]
        faults += [f"{name}: {len(drawn)} of {n} charts" for n, drawn in shown if len(drawn) != n]
        if name in WRITTEN and charts < WRITTEN[name][1]:
            faults.append(f"{name}: {charts} charts, expected {WRITTEN[name][1]}")
        for _, drawn in shown:
            faults += [f"{name}: chart {k} has no labels" for k, texts in enumerate(drawn) if not texts]
            if drawn and sum(bool(re.search(r"\d", text)) for text in drawn[-1]) < 2:
                faults.append(f"{name}: no numbers below the last chart: {drawn[-1]}")
        page.close()
    context.close()
    with capsys.disabled():
        print("", *told, f"{len(told)} pages, errors {len(faults)}", sep="\n")
    assert faults == []


@pytest.fixture(scope="session")
def fmu(once: Callable[[str, Any], Path]) -> Path:
    """The diagnosis of the harvester, as in tests/diagnosis."""
    from fmus.machine.build import harvester

    folder = once("diagnosis", lambda f: harvester(faults=True).write(f, only=("diagnosis",)))
    return folder / "diagnosis.fmu"
