"""Names in a recording that no procedure reads: misspelt ones are refused, others are reported.

Without this check a misspelt signal or condition would be ignored silently. Wrong units are refused as well,
before the procedures run for minutes.
"""

from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches

from fmus.composition import declared
from fmus.identification.recordings.reading import CONDITIONS, MACHINE, MACHINE_SIGNALS, NOTE, REST, require
from fmus.machine.parts import FERIC
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

TEMPERATURE = "oil_temperature"  # an optional signal of all recordings [K]
GROUPS = ("inputs", "outputs")  # of the machine's variables that can be recorded
UNREAD: Mapping[str, tuple[str, ...]] = {"hose_dynamics": ("command",)}  # usual signals that are not needed
# similarity above which a name is a misspelling of another; names of the machine have much in common
SIMILAR, SIMILAR_ON_MACHINE = 0.8, 0.85


def check_names(recordings: Sequence[Recording], signals: Mapping[str, Collection[str]]) -> None:
    """Raise Problem if a recording has a signal or a condition that its procedure does not read.

    signals   procedure of a test bench -> names of the signals that it reads
    """
    of_machine = {name for group in GROUPS for name in declared(FERIC.subsystems, group)}
    for recording in recordings:
        procedure, source = recording.procedure, recording.source
        conditions = CONDITIONS.get(procedure)
        if conditions is None:
            continue
        for name in recording.conditions:
            if name not in (*conditions, NOTE):
                similar = _similar(name, conditions, SIMILAR)
                raise Problem(
                    f"{source}: [experiment] {name}: {procedure} does not read it"
                    + (f", expected {similar}" if similar else f"; it reads {', '.join((*conditions, NOTE))}")
                )
        on_machine = procedure in MACHINE_SIGNALS
        expected = of_machine if on_machine else {*signals[procedure], *UNREAD.get(procedure, ())}
        of_driving = (
            {name for names in FERIC.inputs.values() for name in names} if procedure == MACHINE else ()
        )
        for name in recording.signals:
            if recording.sensor(name).delay_error and name not in of_driving:
                only = "only that of a command or line pressure of the machine at work can be estimated"
                raise Problem(f"{source}: signal {name}: delay_error: {only}; `delay` states a known one")
        if procedure == REST:  # any sensor
            continue
        for name in recording.signals:
            if name not in (*expected, TEMPERATURE):
                similar = _similar(name, expected, SIMILAR_ON_MACHINE if on_machine else SIMILAR)
                listed = "inputs and outputs of the machine" if on_machine else ", ".join(sorted(expected))
                raise Problem(
                    f"{source}: signal {name}: {procedure} does not read it"
                    + (f", expected {similar}" if similar else f"; it reads {listed} and {TEMPERATURE}")
                )


def check_units(recordings: Sequence[Recording], signals: Mapping[str, Mapping[str, str]]) -> None:
    """Raise Problem if a recording gives a signal in a unit of another dimension than its procedure reads.

    signals   procedure on a bench -> its signals with their SI units
    """
    declared_units = {n: q.unit for group in GROUPS for n, q in declared(FERIC.subsystems, group).items()}
    for recording in recordings:
        known = declared_units if recording.procedure in MACHINE_SIGNALS else signals[recording.procedure]
        require(recording, {name: unit for name, unit in known.items() if name in recording.signals})


def _similar(name: str, expected: Collection[str], cutoff: float) -> str:
    """The expected name most similar to this one, in upper or lower case, with or without its part."""
    by_last_part: dict[str, list[str]] = {}
    for candidate in sorted(expected):
        by_last_part.setdefault(candidate.lower().rpartition(".")[2], []).append(candidate)
    close = get_close_matches(name.lower().rpartition(".")[2], by_last_part, 1, cutoff)
    # several parts may have the name: prefer the one that is written in front
    return get_close_matches(name.lower(), by_last_part[close[0]], 1, 0.0)[0] if close else ""
