"""A new report is one file: here of how late the steps of a run in real time were."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from orchestrator.base.text import TextTable
from orchestrator.data.table import Array
from orchestrator.pages.figures import PALETTE, TraceFigure, TraceLine, TracePanel
from orchestrator.results.report import Facts, Figure, Report, Section, Table, Text

SHARES = (50, 95, 99.9, 100)  # [%] of the steps


@dataclass(frozen=True)
class Latency:
    """How late each step ended: shape (n,) each, times [s]; limit: largest lateness allowed [s]."""

    time: Array
    late: Array
    limit: float

    def report(self) -> Report:
        """Lateness over time beside its limit, and its quantiles."""
        worst, missed = float(self.late.max()), int((self.late > self.limit).sum())
        verdict = f"{missed} of {len(self.late)} steps late by more than {1e3 * self.limit:g} ms"
        sizes = {share: float(np.percentile(self.late, share)) for share in SHARES}
        rows = [[f"{share:g} %", f"{1e3 * size:.2f} ms"] for share, size in sizes.items()]
        line = TraceLine(self.time, 1e3 * self.late, {"color": PALETTE.ink})
        panel = TracePanel(
            "ms", [line], errors=[line], bounds=[1e3 * self.limit], error_unit="ms", whole=True
        )
        parts = [
            Figure(TraceFigure([panel]), "Latency", f"At most {1e3 * worst:.2f} ms."),
            Section("Quantiles", [Table(TextTable(["steps", "at most"], rows))], only=""),
            Section(
                "Run", [Facts({"steps": len(self.late)}), Text(["times are those of this computer"])], True
            ),
        ]
        return Report(
            "Latency", verdict, parts, {"limit [s]": self.limit, "quantiles [s]": sizes}, not missed
        )


@pytest.mark.parametrize(("limit", "passed"), [(0.5, True), (2e-3, False)])
def test_a_new_report_is_text_page_and_json(tmp_path, limit, passed):
    """The verdict is last in a terminal, first on a page, and in the JSON of the same shape as all others."""
    time = np.linspace(0.0, 1.0, 1001)
    report = Latency(time, 3e-3 * time**4, limit).report()
    lines = report.text().splitlines()
    assert lines[0].split() == ["steps", "at", "most"]
    assert lines[-1] == report.verdict
    page, numbers = (file.read_text(encoding="utf-8") for file in report.write(tmp_path / "latency.html"))
    assert page.index("pass" if passed else "fail", page.index("<header>")) < page.index("At most 3.00 ms")
    assert '<details class="folded"><summary><h2>Run</h2>' in page
    data = json.loads(numbers)
    assert list(data) == ["title", "verdict", "passed", "limit [s]", "quantiles [s]"]
    assert (data["passed"], data["quantiles [s]"]["100"]) == (passed, 3e-3)
