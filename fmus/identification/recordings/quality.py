"""How far a recording can be trusted: `examine` finds what is wrong, `remarks` says it, `table` shows it."""

from __future__ import annotations

from dataclasses import dataclass

from fmus.identification.recordings import clock
from fmus.identification.recordings.clock import Clock
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.signal_quality import SignalQuality, shown, signal_quality


@dataclass(frozen=True)
class Quality:
    """A recording's clock and signals."""

    source: str
    clock: Clock
    signals: tuple[SignalQuality, ...]

    def remarks(self) -> list[str]:
        """Whole sentences, one for each thing that is not as it should be; none for a clean recording."""
        found = [*self.clock.remarks(), *(text for signal in self.signals for text in signal.remarks())]
        still = [f"{s.name} ({shown(s.lowest, s.unit)})" for s in self.signals if s.still]
        return [*found, f"One value throughout: {', '.join(still)}."] if still else found

    def table(self) -> str:
        """One line for each signal: shares of samples, steps and noise as seen (and as told)."""
        head = ("signal", "gaps", "clipped", "stuck", "dead zone", "step (told)", "noise (told)")
        rows = [head, *(_row(signal) for signal in self.signals)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        clock = f"{self.clock.rate:.6g} Hz, jitter {1e3 * self.clock.jitter:.2g} ms"
        return "\n".join([f"{self.source}: {clock}", *lines])


def examine(recording: Recording) -> Quality:
    """What can be told of a recording's quality from its data and what its meta file says."""
    signals = tuple(signal_quality(recording, name) for name in recording.signals)
    return Quality(recording.source.name, clock.examine(recording), signals)


def _row(signal: SignalQuality) -> tuple[str, ...]:
    faults = (signal.gaps, signal.clipped, signal.stuck, signal.dead)
    shares = (f"{100 * fault.share:.2g} %" if fault else "-" for fault in faults)
    told = (signal.sensor.resolution, signal.sensor.noise)
    pairs = zip((signal.step, signal.noise), told, strict=True)
    seen = (f"{shown(v, signal.unit)} ({shown(t, signal.unit) if t else '-'})" for v, t in pairs)
    return (signal.name, *shares, *seen)
