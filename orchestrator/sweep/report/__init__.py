"""The report of a study: report.html and analysis.json beside its results."""

from __future__ import annotations

from pathlib import Path

from orchestrator.sweep.analysis import Analysis, analyse
from orchestrator.sweep.report.page import as_json, render
from orchestrator.sweep.store import Results, read

PAGE, NUMBERS = "report.html", "analysis.json"


def report(folder: Path) -> Path:
    """Analyse the finished study in a folder and write both files there; returns the path of the page."""
    results = read(folder)
    write(folder, results, analyse(results))
    return folder / PAGE


def write(folder: Path, results: Results, analysis: Analysis) -> None:
    """Both files; equal results give equal bytes."""
    texts = {NUMBERS: as_json(results, analysis), PAGE: render(results, analysis)}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")


__all__ = ["NUMBERS", "PAGE", "report", "write"]
