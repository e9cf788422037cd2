"""The tables of docs/fidelity.md; a document keeps each between <!-- name --> and <!-- end -->."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fidelity_cases import IN, OUT, QUICK, SPEEDS, STICK, SWING, TURN, Case, Test, Trace, cycle, tested
from fidelity_combinations import Combination
from fidelity_measures import SPLIT, Mode, Ripple, mode_of, peaks, return_ripple, together

from fmus.machine.parts import FAMILIES, OTHER_CIRCUITS
from orchestrator.base.text import percentage
from orchestrator.results.comparison import Comparison

LEAST = 0.05  # bar: a ripple below has no frequency worth telling
NOTHING = 0.15  # %: a change of peaks below is none


@dataclass(frozen=True)
class Outcome:
    """What came out of one case: ripples by test, peaks [bar] (n, 2) by test, the work cycle."""

    case: Case
    ripples: Mapping[str, Ripple]
    peaks: Mapping[str, np.ndarray]
    cycle: Trace


def measure(system: Path, case: Case) -> Outcome:
    """All tests of a case."""
    whole = cycle(system, case)
    ripples = {name: _ripple(system, case, test) for name, test in (("out", OUT), ("in", IN))}
    found = {name: _peaks(system, case, test) for name, test in (("alone", TURN), ("quick", QUICK))}
    return Outcome(
        case,
        ripples | {"cycle": return_ripple(whole, STICK)},
        found | {"cycle": peaks(whole, SWING)},
        whole,
    )


def _ripple(system: Path, case: Case, test: Test) -> Ripple:
    return together([return_ripple(trace, [move]) for trace, move in tested(system, case, test)])


def _peaks(system: Path, case: Case, test: Test) -> np.ndarray:
    return np.concatenate([peaks(trace, [move]) for trace, move in tested(system, case, test)])


def _rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["|" + "|".join(cell or " " for cell in cells) + "|" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])


def ripple_table(found: Sequence[Outcome], base: Outcome) -> str:
    """Joint speeds in the work cycle, and the ripple of the stick's return pressure."""
    tests = {"out": "out", "in": "in", "cycle": "work cycle"}
    head = ["", *(f"{words}: {what}" for words in tests.values() for what in ("bumps", "ripple")), "speed"]
    rows = []
    for one in found:
        cells = [
            text for name in tests for text in (f"{one.ripples[name].slow:.2f}", _fast(one.ripples[name]))
        ]
        rows.append([one.case.name, *cells, _speed(one, base)])
    return _rows(head, rows)


def _level(found: Ripple) -> tuple[str, str]:
    return f"{found.mean:.0f}", _fast(found)


def _fast(found: Ripple) -> str:
    """The ripple with its frequency, if that is not the flank of the bumps."""
    return f"{found.fast:.2f}" + (f" at {found.peak:.1f} Hz" if _told(found) else "")


def _told(found: Ripple) -> bool:
    return found.fast > LEAST and found.peak > 1.1 * SPLIT


def level_table(found: Sequence[Outcome]) -> str:
    """Mean return pressures beside the ripple."""
    rows = [
        [one.case.name, *(text for n in ("out", "in") for text in _level(one.ripples[n]))] for one in found
    ]
    return _rows(["", "out: mean", "ripple", "in: mean", "ripple"], rows)


def _speed(one: Outcome, base: Outcome) -> str:
    """Worst RMS difference of a joint speed over its range."""
    if one is base:
        return ""
    apart = (np.std(one.cycle[n] - base.cycle[n]) / np.ptp(base.cycle[n]) for n in SPEEDS)
    return f"{100 * max(apart):.2g} %"


def peak_table(found: Sequence[Outcome], base: Outcome) -> str:
    """Change of the swing's pressure peaks, mean and range over the strokes."""
    head = ["", "start, alone", "start, work cycle", "stop, alone", "stop, work cycle", "stop in 0.3 s"]
    rows = []
    for one in found:
        row = [one.case.name]
        for side in (0, 1):
            row += [_change(one.peaks[t][:, side], base.peaks[t][:, side], one is base) for t in TESTS]
        rows.append([*row, f"{one.peaks['quick'][0, 1]:.0f} bar"])
    return _rows(head, rows)


def sensitivity(found: Sequence[Outcome], base: Outcome) -> list[list[str]]:
    """Rows of docs/fidelity-sensitivity.csv: ripples [bar, Hz] and changes of the peaks [%], head first."""
    strokes = [f"{side} {t}" for side in ("start", "stop") for t in ("alone", "work cycle")]
    head = ["case"]
    for test in ("out", "in", "work cycle"):
        head += [f"{test} bumps [bar]", f"{test} ripple [bar]", f"{test} ripple at [Hz]"]
    head += ["speed [%]", *(f"{s} {what} [%]" for s in strokes for what in ("mean", "least", "largest"))]
    rows = [[*head, "stop in 0.3 s [bar]"]]
    for one in found:
        row = [one.case.name.replace("`", "")]
        for name in ("out", "in", "cycle"):
            seen = one.ripples[name]
            row += [f"{seen.slow:.2f}", f"{seen.fast:.2f}", f"{seen.peak:.1f}" if _told(seen) else ""]
        row.append(_speed(one, base).removesuffix(" %"))
        for side in (0, 1):
            for t in TESTS:
                share = 100 * (one.peaks[t][:, side] / base.peaks[t][:, side] - 1)
                row += [f"{share.mean():.1f}", f"{share.min():.0f}", f"{share.max():.0f}"]
        rows.append([*row, f"{one.peaks['quick'][0, 1]:.0f}"])
    return rows


TESTS = ("alone", "cycle")


def _change(values: np.ndarray, base: np.ndarray, itself: bool) -> str:
    if itself:
        return f"{values.min():.0f} to {values.max():.0f} bar"
    share = 100 * (values / base - 1)
    if np.abs(share).max() < NOTHING:
        return "0 %"
    return f"{share.mean():+.1f} % ({share.min():+.0f} to {share.max():+.0f})"


LED = {
    "head, in the plane of the arm": "manipulator.head_angle|manipulator.head_speed",
    "head, sideways": "manipulator.head_side",
    "hydraulic oscillation of swing": "manipulator.swing_speed",
    "hydraulic oscillation of boom": "manipulator.boom_speed",
    "hydraulic oscillation of stick": "manipulator.stick_speed",
    "stick's hoses": "boom_stick.stick_head_hose|boom_stick.stick_rod_hose",
    "boom's hoses": "boom_stick.boom_head_hose|boom_stick.boom_rod_hose",
    "spools": "_spool_",
    "engine with governor": "supply.engine",
    "pumps with compensators": "supply.pump",
}


def mode_table(found: Mapping[str, Sequence[Mode]]) -> str:
    """Slowest oscillation of each kind: frequency and damping ratio."""
    rows = []
    for name, words in LED.items():
        modes = [next(filter(None, (mode_of(m, w) for w in words.split("|"))), None) for m in found.values()]
        rows.append([name, *(f"{m.frequency:.2g} Hz, {m.damping:.2g}" if m else "" for m in modes)])
    return _rows(["", *found], rows)


COMBINED = (
    ("quasistatic", "quasistatic", "rigid", "ideal"),
    ("quasistatic", "quasistatic", "pendulum", "ideal"),
    ("lumped", "lumped", "rigid", "ideal"),
    ("lumped", "lumped", "pendulum", "ideal"),
    ("lumped", "lumped", "pendulum", "engine_pump"),
    ("lumped", "detailed", "rigid", "ideal"),
    ("detailed", "detailed", "pendulum", "engine_pump"),
    ("detailed", "detailed", "pendulum_friction", "engine_pump"),
)


def combination_table(rows: Sequence[Combination], costs: Mapping[str, Mapping[str, float]]) -> str:
    """Some combinations with a meaning: costs of their parts added up, and change; ranges of all."""
    found = {tuple(row.variants.values()): row for row in rows}

    def cost(row: Combination) -> float:
        return sum(costs[part][variant] for part, variant in row.variants.items())

    cells = [[*key, f"{cost(found[key]):.1f}", f"{100 * found[key].change:.2g} %"] for key in COMBINED]
    change, spent = ([f(row) for row in rows] for f in (lambda row: 100 * row.change, cost))
    ended = sum(not row.failure for row in rows)
    summary = (
        f"{ended} of {len(rows)} combinations come to the end of the work cycle. They cost {min(spent):.1f} "
        f"to {max(spent):.1f} µs per step of 1 ms and change joint speeds by up to {max(change):.2g} %; "
        "the energy error of the coupling is "
        f"at most {100 * max(row.residual for row in rows):.1g} % at any bond."
    )
    return summary + "\n\n" + _rows([*rows[0].variants, "µs per 1 ms", "change"], cells)


def rows_of_costs(
    part: str, runs: Comparison, cost: Mapping[str, float], states: Mapping[str, int]
) -> list[str]:
    """A row for each variant of a part: states, cost, worst error of each kind against the most detailed.

    Without errors of variants with another circuit.
    """
    table = []
    for one in runs.runs:
        same = one is not runs.reference and one.label not in OTHER_CIRCUITS
        errors = [runs.worst(one.label, kind) if same else None for kind in KINDS]
        told = [percentage(row.metrics.nrmse) if row else "" for row in errors]
        table.append([part, one.label, str(states[one.label]), f"{cost[one.label]:.2f}", *told])
    lines = _rows(["part", "variant", "states", "µs per 1 ms", *KINDS], table).splitlines()
    return lines if part == next(iter(FAMILIES)) else lines[2:]


KINDS = ("speed", "angle", "pressure")


def fill(document: Path, name: str, table: str) -> None:
    """Put a table in its place."""
    text = document.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- {name} -->\n).*?(\n<!-- end -->)", re.DOTALL)
    if not place.search(text):
        raise SystemExit(f"{document}: expected a place <!-- {name} -->")
    told = place.sub(lambda m: m[1] + table + m[2], text)
    document.write_text(told, encoding="utf-8", newline="\n")
