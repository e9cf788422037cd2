"""Makes the figures and numbers of docs/identification.md: `python docs/identification.py [folder]`.

The paper's Figs. 5 to 11, from recordings of the virtual test rig. Minutes. The folder is where the
recordings go, by default one that is removed at the end; recordings that are there are not made again.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path

from PIL import Image

from benchmarks import openings
from fmus.identification.machine import lookup, nominal
from fmus.identification.pipeline import Identified, identify
from fmus.identification.procedures import valve, weighing
from fmus.identification.recordings.reading import MACHINE, read_folder
from fmus.identification.report import identification_page as texts
from fmus.identification.report.attribution import Explanation, attribute
from fmus.identification.report.figures import joint_figure, procedure_figures
from fmus.identification.report.prediction import (
    WINDOW,
    RecordingComparison,
    default_values,
    prediction,
    worst,
)
from fmus.identification.results import Estimate, ProcedureResult
from fmus.rig import write_all
from orchestrator.base.text import TextTable, display_unit, typeset
from orchestrator.pages import plotting
from orchestrator.pages.plotting import png

HERE = Path(__file__).parent
PAGE, FIGURES = HERE / "identification.md", HERE / "figures"
PROCEDURES = {  # number in the paper, name of the file
    "valve": (5, "valve"),
    "hose_resistance": (6, "hose_resistance"),
    "hose_dynamics": (7, "hose_dynamics"),
    "motor_leakage": (8, "motor_leakage"),
    "damping": (9, "damping"),
}
JOINTS = {"swing": 10, "stick": 11}
KINDS = {"angle": "joint angles", "speed": "joint speeds", "pressure": "pressures", "flow": "flows"}
LIMITS = {"angle": "1 %", "speed": "5 %", "pressure": "10 %"}
REPORT_ONLY = ("nothing is left out",)  # remarks of which the page needs none


def main() -> None:
    """Everything, in a folder of the user's or a temporary one."""
    if len(sys.argv) > 1:
        everything(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            everything(Path(folder))


def everything(folder: Path) -> None:
    """Record on both machines, identify, draw, fill in."""
    FIGURES.mkdir(exist_ok=True)
    found = {machine: recorded(folder / machine, machine) for machine in ("lumped", "detailed")}
    fill("returned", returned(found["lumped"]))
    fill("payload", "\n".join(payloads(found)))
    draw(found["detailed"])
    opening_curve()
    seen = prediction(found["detailed"])
    assert seen is not None
    for joint, number in JOINTS.items():
        (FIGURES / f"fig{number:02d}_{joint}.png").write_bytes(png(plotting.draw(joint_figure(seen, joint))))
    fill("figures 10 and 11", work_cycle(seen))
    fill("held out", held_out(seen))
    told = attribute(seen, default_values(found["detailed"]))
    fill("residual", effects(told))
    fill("refined", refined(found["detailed"]))


def recorded(folder: Path, machine: str) -> Identified:
    """What is identified from the recordings of a machine."""
    if not folder.is_dir():
        write_all(folder, machine, 0)
    return identify(read_folder(folder), report=print)


def draw(found: Identified) -> None:
    """The figures of the procedures, with what they found."""
    kinds = [r.kind for r in found.recordings]
    for result in (r for r in found.results if r.procedure in PROCEDURES):
        number, name = PROCEDURES[result.procedure]
        pictures(f"fig{number:02d}_{name}", result, kinds)
        fill(f"figure {number}", "\n".join([estimates(result.estimates), "", *remarks(result, REPORT_ONLY)]))


def pictures(name: str, result: ProcedureResult, kinds: Sequence[str]) -> None:
    """The figures of a procedure below each other, in one file."""
    drawn = [Image.open(BytesIO(png(plotting.draw(f)))) for f in procedure_figures(result, kinds)]
    whole = Image.new("RGB", (max(i.width for i in drawn), sum(i.height for i in drawn)), "white")
    for k, picture in enumerate(drawn):
        whole.paste(picture, (0, sum(i.height for i in drawn[:k])))
    whole.save(FIGURES / f"{name}.png")


def opening_curve() -> None:
    """The figure of two edges with openings that are no straight lines, by equations of their own."""
    result = valve.identify(openings.recordings("asymmetric 1", seed=0), openings.KNOWN)
    pictures("fig05_opening_curve", result, ["simulation"])
    fill("opening curve", "\n".join([estimates(result.estimates), "", *remarks(result, REPORT_ONLY)]))


def remarks(result: ProcedureResult, omitted: Sequence[str]) -> list[str]:
    """The remarks of a procedure as a list, except those with one of these texts."""
    return [f"- {typeset(r)}" for r in result.remarks if not any(text in r for text in omitted)]


def work_cycle(seen: RecordingComparison) -> str:
    """What the figures of the joints show."""
    title = seen.recording.title[0].lower() + seen.recording.title[1:]
    return (
        f"Data: {title}, simulated. For the speeds both angles are differentiated by one filter, "
        f"{1000 * WINDOW:.0f} ms wide. Flows in the dead zone of the meter are left out."
    )


def estimates(found: Iterable[Estimate]) -> str:
    """A table of parameters."""
    rows = [(f"`{e.name}`", *value(e), e.note) for e in found]
    return table(("parameter", "value", "95 % interval", "unit", "how"), rows)


def value(e: Estimate) -> tuple[str, str, str]:
    """Value, interval and unit as they are shown."""
    return texts.value(e), texts.interval(e), display_unit(e.unit).name


def returned(found: Identified) -> str:
    """What the procedures gave back of the numbers that the rig has."""
    rows = []
    for result in found.results:
        for e in result.estimates:
            truth = lookup(e.name, nominal()).value
            holds = "yes" if e.low <= truth <= e.high else "no"
            shown = texts.number(truth, 4, e.unit)
            rows.append((f"`{e.name}`", shown, *value(e), texts.change(e.value, truth), holds))
    head = ("parameter", "rig", "identified", "95 % interval", "unit", "off by", "interval contains it")
    return table(head, rows)


def payloads(found: Mapping[str, Identified]) -> Iterator[str]:
    """The weighed payload of both machines, with and without the recording of the empty head."""
    rows = []
    for machine, identified in found.items():
        loaded = weighing.WEIGHING.identify(
            [r for r in identified.recordings if r.conditions.get("payload") != 0.0], nominal()
        )
        (tared,) = (r for r in identified.results if r.procedure == "weighing")
        cells = [cell for result in (tared, loaded) for cell in value(result.others[0])[:2]]
        rows.append((machine, *cells))
    yield table(("rig", "with tare [kg]", "95 % interval", "without tare [kg]", "95 % interval"), rows)
    (weighed,) = (r for r in found["detailed"].results if r.procedure == "weighing")
    (model,) = (f.sentence for f in weighed.findings if f.fault == "model")
    yield f"\nOn the detailed machine {model.removeprefix('weighing: ')}, and `identify` warns."


def refined(found: Identified) -> str:
    """What the joint refinement made of them, and what was known before it."""
    rows = []
    for name, (e, procedure) in found.estimates.items():
        if procedure == MACHINE:
            before = texts.number(lookup(name, nominal()).value, 4, e.unit)
            rows.append((f"`{name}`", before, *value(e)))
    return table(("parameter", "in the model", "identified", "95 % interval", "unit"), rows)


def held_out(seen: RecordingComparison) -> str:
    """The worst signal of each kind in the cycle that was not used for fitting."""
    rows = [
        (KINDS[kind], f"`{name}`", texts.percentage(error, 3), LIMITS.get(kind, ""))
        for kind, (name, error) in worst(seen.nrmse()).items()
    ]
    return table(("", "worst signal", "NRMSE", "limit"), rows)


def effects(found: Explanation) -> str:
    """Which effect the residual shows."""
    rows = [
        (
            s.effect,
            texts.percentage(s.alone),
            texts.number(s.coefficient, 2),
        )
        for s in found.shares
    ]
    return f"{found.verdict}\n\n" + table(("effect", "alone", "strength"), rows)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of the page."""
    return TextTable(head, rows, left=range(len(head))).markdown()


def fill(name: str, text: str, document: Path = PAGE) -> None:
    """Put a text in its place, between <!-- name --> and <!-- end -->."""
    page = document.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not place.search(page):
        raise SystemExit(f"{document}: expected a place <!-- {name} -->")
    document.write_text(place.sub(lambda m: f"{m[1]}{text}\n{m[2]}", page), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
