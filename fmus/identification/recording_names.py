"""Names in a recording that no procedure reads: misspelt ones are refused, others are reported.

Without this check a misspelt signal or condition would be ignored silently. Wrong units are refused as well,
before the procedures run for minutes.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from difflib import get_close_matches

from fmus.composition import declared
from fmus.identification.recordings.reading import require
from fmus.machine.parts import SUBSYSTEMS
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

MACHINE = "machine"
GROUPS = ("inputs", "outputs")  # of the machine's variables that can be recorded
MACHINE_SIGNALS = (MACHINE, "damping", "weighing")  # procedures whose signals are those of the machine
# keys of [experiment] that a procedure reads, except procedure and use; other keys may be notes
CONDITIONS: Mapping[str, tuple[str, ...]] = {
    "valve": ("edge", "density"),
    "hose_resistance": ("length", "diameter", "density"),
    "hose_dynamics": ("length", "diameter", "density"),
    "motor_leakage": ("shaft", "tank_pressure"),
    "damping": ("joint", "tank_pressure"),
    "weighing": ("payload", "tank_pressure"),
    MACHINE: ("tank_pressure",),
}
UNREAD: Mapping[str, tuple[str, ...]] = {"hose_dynamics": ("command",)}  # usual signals that are not needed
# similarity above which a name is a misspelling of another; names of the machine have much in common
SIMILAR, SIMILAR_ON_MACHINE = 0.8, 0.85


def name_remarks(recordings: Sequence[Recording], signals: Mapping[str, Collection[str]]) -> Iterator[str]:
    """Sentences on signals that are not read. Raises Problem if a name is close to one that is read.

    signals   procedure of a test bench -> names of the signals that it reads
    """
    for recording in recordings:
        _check_conditions(recording)
    for recording in recordings:
        if recording.procedure in MACHINE_SIGNALS:
            yield from _unknown_to_machine(recording)
        elif recording.procedure in signals:
            yield from _unknown_to_bench(recording, signals[recording.procedure])


def check_units(recordings: Sequence[Recording], signals: Mapping[str, Mapping[str, str]]) -> None:
    """Raise Problem if a recording gives a signal in a unit of another dimension than its procedure reads.

    signals   procedure on a bench -> its signals with their SI units
    """
    declared_units = {n: q.unit for group in GROUPS for n, q in declared(SUBSYSTEMS, group).items()}
    for recording in recordings:
        known = declared_units if recording.procedure in MACHINE_SIGNALS else signals[recording.procedure]
        require(recording, {name: unit for name, unit in known.items() if name in recording.signals})


def _unknown_to_machine(recording: Recording) -> Iterator[str]:
    expected = {name for group in GROUPS for name in declared(SUBSYSTEMS, group)}
    unknown = [name for name in recording.signals if name not in expected]
    for name in unknown:
        if similar := _similar(name, expected, SIMILAR_ON_MACHINE):
            raise Problem(
                f"{recording.source}: signal {name}: expected an input or output of the machine, such "
                f"as {similar}"
            )
    if unknown:
        yield (
            f"{recording.source.name}: not used, because the machine has no such signal: {', '.join(unknown)}"
        )


def _unknown_to_bench(recording: Recording, signals: Collection[str]) -> Iterator[str]:
    """A test bench may have further signals of any name, so a similar name is only reported."""
    expected = {*signals, *UNREAD.get(recording.procedure, ())}
    missing = expected - set(recording.signals)
    unknown = []
    for name in recording.signals:
        if name not in expected:
            similar = _similar(name, missing, SIMILAR)
            unknown.append(f"{name} (misspelt {similar}?)" if similar else name)
    if unknown:
        procedure, names = recording.procedure, ", ".join(unknown)
        yield f"{recording.source.name}: not used, because {procedure} needs no such signal: {names}"


def _check_conditions(recording: Recording) -> None:
    """Refuse a key that is similar to one that the procedure reads; other keys may be notes."""
    expected = CONDITIONS.get(recording.procedure, ())
    read_by_any = {name for names in CONDITIONS.values() for name in names}
    for name in recording.conditions:
        similar = "" if name in read_by_any else _similar(name, expected, SIMILAR)
        if similar:
            raise Problem(f"{recording.source}: [experiment] unknown key {name}, expected {similar}")


def _similar(name: str, expected: Collection[str], cutoff: float) -> str:
    """The expected name most similar to this one, in upper or lower case, with or without its part."""
    by_last_part: dict[str, list[str]] = {}
    for candidate in sorted(expected):
        by_last_part.setdefault(candidate.lower().rpartition(".")[2], []).append(candidate)
    close = get_close_matches(name.lower().rpartition(".")[2], by_last_part, 1, cutoff)
    # several parts may have the name: prefer the one that is written in front
    return get_close_matches(name.lower(), by_last_part[close[0]], 1, 0.0)[0] if close else ""
