"""The lines of a picture: which settings share one, and in which colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from orchestrator.convergence.study import Row, Study

# One colour for each family, different in hue and in lightness (Okabe and Ito, darkened).
COLOURS = {"plain": "#c2341d", "jacobi": "#c98500", "gauss-seidel": "#00735a", "hermite": "#0b5fa5"}
COLOURS |= {"own steps": "#8f3f8f"}
OTHER = "#333333"
ALIKE = 0.01  # settings whose errors differ by less share a line


@dataclass(eq=False)
class Line:
    """The rows of one setting, or of several that give the same."""

    names: list[str]
    rows: list[Row]
    colour: str
    place: int  # in its family

    stable: list[Row] = field(init=False)
    lost: list[Row] = field(init=False)

    def __post_init__(self) -> None:
        self.stable = [row for row in self.rows if row.stable]
        self.lost = [row for row in self.rows if not row.stable and not row.refused]

    @property
    def name(self) -> str:
        """The settings, a common first word told once."""
        first = self.names[0].split()[0]
        return ", ".join([self.names[0], *(n.removeprefix(f"{first} ") for n in self.names[1:])])


def lines_of(study: Study, group: str) -> list[Line]:
    """One for each setting; those that give the same as one before share its line."""
    lines: list[Line] = []
    count: dict[str, int] = {}
    for setting in study.settings:
        rows = study.of(setting)
        twin = next((line for line in lines if _alike(line.rows, rows, group)), None)
        if twin is not None:
            twin.names.append(setting.label)
            continue
        place = count.get(setting.family, 0)
        count[setting.family] = place + 1
        lines.append(Line([setting.label], rows, COLOURS.get(setting.family, OTHER), place))
    return lines


def _alike(first: Sequence[Row], second: Sequence[Row], group: str) -> bool:
    """The same steps, stable at the same ones, with the same errors there."""
    if [(r.mean_step, r.stable) for r in first] != [(r.mean_step, r.stable) for r in second]:
        return False
    pairs = [(a.error(group), b.error(group)) for a, b in zip(first, second, strict=True) if a.stable]
    return bool(pairs) and all(abs(a - b) <= ALIKE * max(a, b) for a, b in pairs)
