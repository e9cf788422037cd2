"""Data quality of recordings, for the page and in short."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fmus.identification.recordings.quality import examine
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.signal_quality import SignalQuality
from fmus.identification.recordings.uniform import FASTEST, evenly
from fmus.identification.report.content import Channel, Quality


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
