"""Sets of numbers: which parts they reach, what follows from them, what is refused."""

import pytest
from kit import mistakes

from fmus.contract import quantities
from fmus.machine.build import harvester_machine
from fmus.machine.one_block import harvester_block
from fmus.machine.parts import FAMILIES, FERIC
from fmus.machine.poses import NOMINAL, POSES, parameter_sets, pose_set
from fmus.manipulator import MANIPULATOR
from fmus.parameters import numbers, values

ENTRY = '[parameters.{}]\nvalue = {}\nunit = "{}"\nsource = "identified"\nnote = "{}"\n'
VALVE = ENTRY.format("valve_area", 4.1e-5, "m2", "bench") + "sd = 1e-7\n"
PRELOAD = ENTRY.format('"swing.initial_preload"', 1.2e6, "Pa", "read")
MASS = ENTRY.format("head_mass", 400.0, "kg", "weighed")


@pytest.fixture
def changed(tmp_path):
    """The machine with a set of three numbers."""
    (tmp_path / "set.toml").write_text(VALVE + PRELOAD + MASS, encoding="utf-8")
    return harvester_machine(tmp_path / "set.toml")


@pytest.fixture
def machine(changed):
    """All its parts by name."""
    variants = {sub.name: sub for family in changed.families.values() for sub in family.values()}
    return {**variants, **changed.components}


def test_a_name_reaches_every_part_that_declares_it(machine):
    """The valves are identical, so one area goes to all drives at all fidelities, with its source and sd.

    The sections of the compensated drives are other valves: they are stated by their flows.
    """
    holders = {n for n, sub in machine.items() if "valve_area" in quantities(sub.parameters)}
    drives = FAMILIES["swing"].items() | FAMILIES["boom_stick"].items()
    assert holders == {sub.name for variant, sub in drives if variant != "compensated"}
    for name in holders:
        number = numbers(machine[name])["parameters"]["valve_area"]
        assert (number.value, number.source, number.note, number.sd) == (4.1e-5, "identified", "bench", 1e-7)


def test_a_name_with_its_part_reaches_that_part_only(machine):
    """Both drives have a preload, and they are two things."""
    found = {n: values(machine[n]).p["initial_preload"] for n in ("swing", "swing_detailed", "boom_stick")}
    usual = values(FERIC.subsystems["boom_stick"]).p["initial_preload"]
    assert found == {"swing": 1.2e6, "swing_detailed": 1.2e6, "boom_stick": usual}


def test_what_the_set_leaves_out_stays(machine):
    """Nothing but the named numbers and what follows from them changes."""
    changed = {}
    for name, sub in FERIC.components.items():
        old, new = numbers(sub), numbers(machine[name])
        assert {s: set(t) for s, t in old.items()} == {s: set(t) for s, t in new.items()}
        changed |= {f"{name}.{v}": s for s, t in old.items() for v, n in t.items() if new[s][v] != n}
    named = {"swing.valve_area", "swing.initial_preload", "boom_stick.valve_area", "manipulator.head_mass"}
    assert {v for v, section in changed.items() if section == "parameters"} == named
    # a heavier head is held by other forces; positions of the pistons do not change
    forces = (("manipulator", "force"), ("boom_stick", "holding_force"))
    held = {f"{part}.{joint}_{what}" for joint in ("boom", "stick") for part, what in forces}
    assert {v for v, section in changed.items() if section == "start"} == held


def test_the_whole_and_the_poses_follow(machine, changed):
    """The one block and the poses of the system are of the same machine as the parts."""
    block = values(harvester_block(changed)).p
    assert (block["valve_area"], block["swing_initial_preload"], block["head_mass"]) == (4.1e-5, 1.2e6, 400.0)
    pose = parameter_sets(machine["manipulator"])[NOMINAL]
    assert pose == pose_set(POSES[NOMINAL], machine["manipulator"])
    start = {n: number.value for n, number in numbers(machine["boom_stick"])["start"].items()}
    assert start["boom_holding_force"] == pose["boom_stick.boom_holding_force"]
    lighter = pose_set(POSES[NOMINAL], MANIPULATOR)
    assert pose["boom_stick.boom_holding_force"] > lighter["boom_stick.boom_holding_force"]


@mistakes.table(__file__, "mistakes", "entry, old, new, message")
def test_a_mistake_is_told_in_one_line(entry, old, new, message, tmp_path, monkeypatch, capsys):
    """File, thing, expected, found; before anything is compiled or written."""
    monkeypatch.chdir(tmp_path)
    text = {"valve": VALVE, "preload": PRELOAD, "nothing": ""}[entry].replace(old, new)
    (tmp_path / "set.toml").write_text(text, encoding="utf-8")
    line = mistakes.refused(capsys, ["build", "--parameters", "set.toml"])
    assert line.startswith(f"harvester: set.toml: {message}")
    assert not list((tmp_path / "build").glob("*.fmu"))
