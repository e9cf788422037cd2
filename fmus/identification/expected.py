"""Is what recordings tell what somebody reads? A misspelt name would be left out without a word."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from difflib import get_close_matches

from fmus.contract import ModelError
from fmus.flat import declared
from fmus.identification.recordings.recording import Recording
from fmus.identification.steps import MACHINE, PROCEDURES
from fmus.machine import SUBSYSTEMS

OF_MACHINE = (MACHINE, "damping")  # procedures whose signals are those of the machine
# of [experiment], beside procedure and use: what a procedure reads, and what only tells how a test was done
CONDITIONS: Mapping[str, tuple[str, ...]] = {
    "valve": ("edge",),
    "hose_resistance": ("length", "diameter", "density"),
    "hose_dynamics": ("length", "diameter", "density"),
    "motor_leakage": ("shaft", "tank_pressure"),
    "damping": ("joint", "tank_pressure"),
    MACHINE: ("tank_pressure",),
}
ALSO: Mapping[str, tuple[str, ...]] = {"hose_dynamics": ("command",)}  # recorded by a bench, needed by nobody
# likeness from which a name is taken for a misspelling of another; names of the machine have much in common
ALIKE, ALIKE_ON_MACHINE = 0.8, 0.85


def remarks(recordings: Sequence[Recording]) -> list[str]:
    """Sentences on what is not read; a name that is nearly one that is read is refused."""
    for recording in recordings:
        _check_conditions(recording)
    return [text for recording in recordings for text in _signals(recording)]


def _signals(recording: Recording) -> Iterator[str]:
    """The machine's signals are refused if they come close to another, a bench's are only named."""
    if recording.procedure not in PROCEDURES and recording.procedure != MACHINE:
        return
    of_machine = recording.procedure in OF_MACHINE
    known = _of_machine() if of_machine else _of_bench(recording.procedure)
    unknown = [name for name in recording.signals if name not in known]
    for name in unknown if of_machine else ():
        near = _near(name, known, ALIKE_ON_MACHINE)
        if near:
            raise ModelError(
                f"{recording.source}: signal {name} is no input or output of the machine, expected {near}"
            )
    if unknown:
        what = "the machine" if of_machine else recording.procedure
        names = [f"{name}{_meant(name, known, recording)}" for name in unknown]
        yield f"{recording.source.name}: no signal of {what}, not used: {', '.join(names)}"


def _check_conditions(recording: Recording) -> None:
    """A key that is nearly one that counts is refused; any other may be a note."""
    known = CONDITIONS.get(recording.procedure, ())
    anywhere = {name for names in CONDITIONS.values() for name in names}
    for name in recording.conditions:
        near = "" if name in anywhere else _near(name, known, ALIKE)
        if near:
            raise ModelError(f"{recording.source}: [experiment] unknown key {name}, expected {near}")


def _of_machine() -> set[str]:
    return {*declared(SUBSYSTEMS, "inputs"), *declared(SUBSYSTEMS, "outputs")}


def _of_bench(procedure: str) -> set[str]:
    return {*PROCEDURES[procedure].SIGNALS, *ALSO.get(procedure, ())}


def _near(name: str, known: Collection[str], alike: float) -> str:
    """The known name that this one may be meant for, in whatever case and with or without its part."""
    ends: dict[str, list[str]] = {}
    for own in sorted(known):
        ends.setdefault(_end(own), []).append(own)
    close = get_close_matches(_end(name), ends, 1, alike)
    # of equal ends that of the part which was written
    return get_close_matches(name.lower(), ends[close[0]], 1, 0.0)[0] if close else ""


def _end(name: str) -> str:
    return name.lower().rpartition(".")[2]


def _meant(name: str, known: Collection[str], recording: Recording) -> str:
    """The name that is missing, if this one comes close to it."""
    near = _near(name, [own for own in known if own not in recording.signals], ALIKE)
    return f" (misspelt {near}?)" if near else ""
