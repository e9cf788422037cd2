"""Data quality of recordings for the page."""

from __future__ import annotations

from fmus.identification.recordings.quality import SignalQuality, examine
from fmus.identification.recordings.recording import Recording
from fmus.identification.report.content import Channel, Quality


def quality(recording: Recording) -> Quality:
    """What can be told of a recording's clock and signals."""
    found = examine(recording)
    return Quality(
        name=recording.source.name,
        title=recording.title,
        procedure=recording.procedure,
        use=recording.use,
        kind=recording.kind,
        duration=float(recording.time[-1] - recording.time[0]),
        rate=found.clock.rate,
        channels=tuple(map(_channel, found.signals)),
        remarks=tuple(found.clock.remarks()),
    )


def _channel(signal: SignalQuality) -> Channel:
    return Channel(
        signal=signal.name,
        unit=signal.unit,
        low=signal.lowest,
        high=signal.highest,
        noise=signal.noise,
        sensor=signal.sensor.text,
        remarks=tuple(text.removeprefix(f"{signal.name}: ") for text in signal.remarks()),
    )
