"""A joint refinement for the page.

Data quality of recordings, for the page and in short.

The report of an identification: one self-contained HTML file, and the same numbers as JSON.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from fmus.identification.known import Finding
from fmus.identification.recordings.clock import FASTEST, evenly
from fmus.identification.recordings.quality import SignalQuality, examine
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.random_starts import Start as Begun
from fmus.identification.refinement.random_starts import Starts
from fmus.identification.refinement.result import Refined, advice
from fmus.identification.report import figures, wording
from fmus.identification.report.content import Channel, Fit, Page, Quality, Refinement, Start
from fmus.identification.report.panels import embed, prose
from orchestrator.data.recording import Recording


def refinement(
    refined: Refined,
    names: Mapping[str, str] | None = None,
    signals: Mapping[str, str] | None = None,
    facts: Mapping[str, str] | None = None,
    starts: Starts | None = None,
) -> Refinement:
    """What the page tells of a refinement.

    names, signals   parameter and output of the problem -> what the page calls them
    facts            what else is to be told, such as the time it took
    starts           the same search from random starts
    """
    names, signals = names or {}, signals or {}
    problem, found = refined.problem, refined.statistics
    seconds = sum(float(run.time[-1] - run.time[0]) for run in problem.training)
    told = {
        "recordings": f"{len(problem.training)} for training, {seconds:.0f} s; "
        f"{len(problem.held_out)} held out",
        "iterations": str(len(refined.history)),
        "ended": refined.reason,
        "95 % intervals": "from the scatter between segments: residuals depend on their past, which noise of"
        " sensors does not explain"
        if refined.robust
        else "from the noise of the sensors: residuals are independent of each other",
        **(facts or {}),
    }
    remarks = [*advice(refined), *(f"{names.get(n, n)} ended at its bound." for n in refined.at_bound)]
    return Refinement(
        names=tuple(names.get(n, n) for n in problem.names),
        correlation=found.correlation,
        condition=found.condition,
        fits=tuple(_fit(refined, k, signals.get(n, n)) for k, n in enumerate(problem.outputs)),
        unidentified=tuple(_renamed(sentence, names) for sentence in refined.unidentified),
        starts=tuple(_start(k, one, problem) for k, one in enumerate(starts.starts if starts else (), 1)),
        facts=told,
        remarks=tuple(remarks),
    )


def _fit(refined: Refined, place: int, name: str) -> Fit:
    tests = refined.whiteness[refined.problem.outputs[place]]
    return Fit(
        signal=name,
        train=_mean([float(t.nrmse()[place]) for t in refined.training]),
        test=_mean([float(t.nrmse()[place]) for t in refined.held_out]),
        noise=_known(tests.rms),
        memory=_known(tests.outside),
        white=_known(tests.ljung_box),
        inputs=max(tests.inputs.values(), default=None),
    )


def _mean(values: Sequence[float]) -> float | None:
    """Root mean square over the recordings that have the signal."""
    known = [v for v in values if np.isfinite(v)]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _start(place: int, one: Begun, problem: EstimationProblem) -> Start:
    """Distances of where a search began and ended."""
    begun = np.array([f.search(one.begun[f.name]) for f in problem.free])
    away = float(np.sqrt(np.mean((begun - problem.search()) ** 2)))
    return Start(f"random {place}", away, one.apart, one.residual, one.iterations)


def _renamed(sentence: str, names: Mapping[str, str]) -> str:
    """A whole sentence with the page's names; longest first, because one may begin like another."""
    known = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    told = re.sub(rf"\b({known})\b", lambda m: names[m[1]], sentence) if names else sentence
    return told if told.endswith(".") else f"{told}."


def quality(recording: Recording) -> Quality:
    """What can be told of a recording's clock and signals."""
    found = examine(recording)
    remarks = list(found.clock.remarks())
    if evenly(recording) is not recording:
        remarks.append(
            f"The clock: all signals are interpolated at {found.clock.rate:.6g} Hz; gaps stay gaps."
        )
    if found.clock.rate > 1.01 * FASTEST and recording.procedure == "machine":
        remarks.append(
            f"The clock: {found.clock.rate:.6g} Hz, filtered to {FASTEST:g} Hz to be fitted together."
        )
    return Quality(
        name=recording.source.name,
        title=recording.title,
        procedure=recording.procedure,
        use=recording.use,
        kind=recording.kind,
        duration=float(recording.time[-1] - recording.time[0]),
        rate=found.clock.rate,
        channels=tuple(map(_channel, found.signals)),
        remarks=tuple(remarks),
    )


def told(qualities: Sequence[Quality]) -> Iterator[str]:
    """What somebody who waits for the results has to read: faults one by one, dead zones in one line."""
    for q in qualities:
        yield from (f"{q.name}: {remark}" for remark in q.remarks)
        yield from (f"{q.name}: {c.signal}: {remark}" for c in q.channels for remark in c.remarks)
    dead = [(c.dead, q.name, c.signal) for q in qualities for c in q.channels if 0 < c.dead < 1]
    if dead:
        share, name, signal = max(dead)
        files = len({file for _, file, _ in dead})
        recordings = "1 recording" if files == 1 else f"{files} recordings"
        yield (
            f"meters in their dead zones, where nothing is used: {recordings},"
            f" at most {100 * share:.2g} % of the samples ({name}: {signal})"
        )


def _channel(signal: SignalQuality) -> Channel:
    return Channel(
        signal=signal.name,
        unit=signal.unit,
        low=signal.lowest,
        high=signal.highest,
        noise=signal.noise,
        sensor=signal.sensor.text,
        remarks=tuple(text.removeprefix(f"{signal.name}: ") for text in signal.faults()),
        dead=signal.dead.share,
    )


TEMPLATES = Path(__file__).with_name("templates")
NAME = "identification"


def write_page(folder: Path, page: Page) -> tuple[Path, Path]:
    """Write identification.html and identification.json to a folder; returns both paths."""
    folder.mkdir(parents=True, exist_ok=True)
    html, data = folder / f"{NAME}.html", folder / f"{NAME}.json"
    html.write_text(render(page), encoding="utf-8", newline="\n")
    text = json.dumps(numbers(page), indent=1, allow_nan=False, ensure_ascii=False)
    data.write_text(text + "\n", encoding="utf-8", newline="\n")
    return html, data


def render(page: Page) -> str:
    """The HTML text; no content from other servers."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["prose"] = prose
    joint = page.refinement
    return environment.get_template("identification.html.j2").render(
        page=page,
        words=wording,
        origin=wording.origin(page.kinds),
        findings=[(f, _figure(f, k, page.kinds), wording.caption(f, page.kinds)) for k, f in _all(page)],
        heat=None
        if joint is None or len(joint.names) < 2
        else embed(figures.draw_matrix(joint.names, joint.correlation), "c-", "Correlation"),
        pictures=[(p, embed(p.figure, f"t{k}-", p.title)) for k, p in enumerate(page.pictures)],
        style=Markup((TEMPLATES / "identification.css").read_text(encoding="utf-8")),
    )


def _all(page: Page) -> Iterable[tuple[int, Finding]]:
    return enumerate(page.findings)


def _figure(finding: Finding, place: int, kinds: Iterable[str]) -> Markup | None:
    if not finding.panels:
        return None
    return embed(figures.draw_finding(finding, kinds, titled=False), f"f{place}-", finding.title)


def numbers(page: Page) -> dict[str, Any]:
    """All numbers of the page in SI units, without the curves of the figures."""
    found = {f.name: getattr(page, f.name) for f in fields(page) if f.name not in ("findings", "pictures")}
    found["findings"] = [{k: v for k, v in _shallow(f).items() if k != "panels"} for f in page.findings]
    plain: dict[str, Any] = _plain(found)
    return plain


def _shallow(value: Any) -> dict[str, Any]:
    return {f.name: getattr(value, f.name) for f in fields(value)}


def _plain(value: Any) -> Any:
    """Dataclasses, mappings, sequences and NumPy numbers as JSON knows them; what is not finite is null."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    return str(value)
