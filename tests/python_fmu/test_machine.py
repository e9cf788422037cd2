"""An FMU in Python in the machine: the example's model by hand."""

import re

import numpy as np
from kit import shards
from kit.any_fmu.edit import edited, renamed

from orchestrator import load, run
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.write import write_ssp


@shards.machine
def test_the_example_stands_in_for_boom_and_stick(system, actuator):
    """The look-up table moves the machine through the start of the work cycle as the lumped drives do."""
    lumped = run(system, stop=5.0).trace
    table = run(system, stop=5.0, swap={"boom_stick": str(actuator)}).trace
    for angle in ("manipulator.boom_angle", "manipulator.stick_angle"):
        moved = np.ptp(lumped[angle])
        assert moved > 0.2  # rad
        # a static table in the place of hoses and chambers: measured 10 and 8 % of the motion
        assert np.abs(table[angle] - lumped[angle]).max() < 0.2 * moved


def test_an_fmu_without_load_pressure_runs_and_says_so(system, actuator, tmp_path):
    """Its wire is left out with a note, with a warning only if the supply needs the load; also in an SSP."""
    line = f"{actuator} has no boom_stick_load_pressure: the load of boom_stick is not sensed"
    usual = run(system, stop=0.1, swap={"boom_stick": str(actuator)})
    assert line in usual.card.notes
    assert usual.card.warnings == ()
    assert (usual.trace["supply.boom_stick_load_pressure"] == 0.0).all()
    needed = run(system, stop=0.1, swap={"boom_stick": str(actuator), "supply": "load_sensing"})
    assert f"{line}; supply (supply_load_sensing) could use this signal" in needed.card.warnings
    assert not any("load_pressure" in note for note in needed.card.notes)
    wires = [str(c) for c in load(write_ssp(needed.system, tmp_path / "mine.ssp")).connections]
    assert wires == [str(c) for c in needed.system.connections]
    assert not any("boom_stick_load_pressure" in wire for wire in wires)


def test_an_fmu_of_the_version_before_fits(fmu_dir, system, tmp_path):
    """Each part without the new ports: one line for each lost signal, none for its rate."""
    new = re.compile("load_pressure|load_sensing|payload_mass")
    notes = {
        "swing": ["flow is not shared with the other drives", "the load of swing is not sensed"],
        "boom_stick": ["flow is not shared with the other drives", "the load of boom_stick is not sensed"],
        "manipulator": ["the head holds nothing"],
        "supply": ["flow is not shared", "the load of swing is", "the load of boom_stick is"],
    }
    for part, expected in notes.items():
        names = [n for n in system.components[part].interface.variables if new.search(n)]
        changes = [renamed(n, f"other_{n}") for n in names]
        changes.append(("<VendorAnnotations>.*</VendorAnnotations>", ""))
        old = edited(fmu_dir / f"{part}.fmu", tmp_path / f"{part}.fmu", *changes)
        swapped = with_swaps(system, {part: old})
        said = [note for note in swapped.notes if note.startswith(f"{old} has no ")]
        assert all(len([note for note in said if text in note]) == 1 for text in expected), said
        assert not any(f"{name}_rate" in note for note in said for name in names)
        assert swapped.warnings == ()
