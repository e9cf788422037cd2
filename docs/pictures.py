"""Makes the picture of README.md from a fresh run: `python docs/pictures.py`."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from fmus.machine.build import data, harvester
from orchestrator import load, run
from orchestrator.data.recording import read_recording
from orchestrator.pages.plotting import draw, png
from orchestrator.results.layout import read_layout
from orchestrator.results.validation import validate
from orchestrator.results.validation_report import traces

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Run the work cycle; draw the boom against the reference."""
    layout = read_layout(data("reference/work_cycle.layout.toml"))
    with tempfile.TemporaryDirectory() as folder:
        harvester().write(Path(folder))
        result = run(load(Path(folder) / "harvester.ssp"), data("scenarios/work_cycle.csv"))
    validation = validate(result.trace, read_recording(data("reference/work_cycle.csv")))
    boom = next(figure for figure in layout.figures if figure.title == "Boom")
    (IMAGES / "validation.png").write_bytes(
        png(draw(replace(traces(boom, validation, result.trace), title=boom.title)))
    )


if __name__ == "__main__":
    main()
