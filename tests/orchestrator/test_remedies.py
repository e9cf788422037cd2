"""What a message tells a reader to do helps, and its numbers are in the reader's units."""

from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import problem

from orchestrator import Trace, read_trace
from orchestrator.base import toml
from orchestrator.base.errors import suggest
from orchestrator.base.text import sized
from orchestrator.data.recording import Recording
from orchestrator.data.trace_writer import RowLayout, TraceInMemory
from orchestrator.engine.scenario import drive
from orchestrator.fmi.messages import WARNING, Log
from orchestrator.results.diagnosis import Diagnosis, Finding
from orchestrator.results.validation import check_comparable

SIGNALS = [
    *("boom_stick.boom_head_pressure", "boom_stick.boom_rod_pressure", "boom_stick.boom_oil_velocity"),
    *("boom_stick.stick_rod_pressure", "manipulator.boom_speed", "manipulator.boom_stop_force"),
    *("manipulator.swing_speed", "supply.tank_pressure", "supply.supply_pressure", "swing.swing_pressure_a"),
]


@pytest.mark.parametrize(
    ("typed", "first"),
    [
        # without its component a name is compared with names, not with those and their components
        ("boom_presure", {"boom_stick.boom_head_pressure", "boom_stick.boom_rod_pressure"}),
        ("stick_rod_presure", {"boom_stick.stick_rod_pressure"}),
        ("boom_sped", {"manipulator.boom_speed"}),
        ("tankpressure", {"supply.tank_pressure"}),
        ("manipulator.swing_sped", {"manipulator.swing_speed"}),
        ("supply_tank_pressure", {"supply.tank_pressure"}),
    ],
)
def test_the_nearest_names_are_proposed_first(typed, first):
    """Of the same quantity of the same part."""
    told = suggest(typed, SIGNALS).removeprefix("; did you mean ").removesuffix("?").split(", ")
    assert set(told[: len(first)]) == first


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (132.4, "N", "132 N"),
        (-824589.0, "N", "-825 kN"),
        (1.834e-7, "m3", "0.183 mL"),
        (0.078, "m3", "78 L"),
        (0.0123, "m", "12.3 mm"),
        (3.6e7, "Pa", "360 bar"),
        (62.8319, "rad/s", "600 rpm"),
        (0.2, "rad/s", "11.5 deg/s"),
        (373.15, "K", "100 degC"),
        (1.2e-3, "m2/s", "1200 mm2/s"),
        (7.5, "m/s", "7.5 m/s"),
        (1.5, "1", "1.5"),
        (3.0, "", "3"),
        (2.0, "furlong", "2 furlong"),
    ],
)
def test_a_value_has_the_unit_of_a_reader(value, unit, text):
    """In a unit of its size, with three digits; an unknown unit stays."""
    assert sized(value, unit) == text


def test_a_warning_of_an_fmu_has_its_largest_value_beside_its_limit():
    """What follows from it stays at the end; of a lower limit the largest magnitude tells nothing."""
    log, record = Log("m"), TraceInMemory()
    stop = "boom reaches the end of its stroke at t = {} s: boom_stop_force = {} N (limit 1 N)"
    for t, force, end in ((0.1, 132.4, ""), (0.3, 9.1, ""), (0.5, 2.0, "; no further warning of it follows")):
        log.add(WARNING, stop.format(t, force) + end)
    log.add(WARNING, "fast oil at t = 0.2 s: velocity = 6.3 m/s (limit 6 m/s): use larger hoses")
    log.add(WARNING, "cold oil at t = 0 s: heat = -25 degC (lower limit -20 degC)")
    units = {"m.boom_stop_force": "N", "m.velocity": "m/s", "m.heat": "K"}
    record.begin(RowLayout(tuple(units), units))
    record.append(np.array([0.0, 0.25]), np.array([[0.0, 6.1, 248.15], [-824589.0, -7.52, 260.0]]))
    assert log.warnings(record) == [
        f"m: {stop.format(0.1, 132.4)}, at most 825 kN at t = 0.25 s, the first of 3 or more",
        "m: fast oil at t = 0.2 s: velocity = 6.3 m/s (limit 6 m/s), at most 7.52 m/s at t = 0.25 s:"
        " use larger hoses",
        "m: cold oil at t = 0 s: heat = -25 degC (lower limit -20 degC)",
    ]


@pytest.mark.parametrize(
    ("data", "got"),
    [
        (b"PK\3\4 \x9e\0", "an archive"),
        (b"title = 1\n\xff\xfe\0\0", "a binary file"),
        ("a = 1\nname = 'Löffel'\n".encode("latin-1"), "line 2 that is not UTF-8: save it as UTF-8"),
    ],
)
def test_what_is_no_text_is_named(tmp_path, data, got):
    """Not by the byte at which the decoder stopped."""
    file = tmp_path / "crane.toml"
    file.write_bytes(data)
    problem(lambda: toml.read_file(file), rf"crane\.toml: expected a text \(TOML\), got {got}$")


@pytest.mark.parametrize(
    ("name", "kind"), [("my.ssp", "a system"), ("MY.FMU", "an FMU"), ("pair.ssd", "a system")]
)
def test_a_model_in_place_of_samples_is_to_be_run(tmp_path, name, kind):
    """It has no signals; to unpack it would not help."""
    (tmp_path / name).write_bytes(b"PK\3\4")
    told = rf"expected a table, it is {kind}; harvester run makes a result of it$"
    problem(lambda: read_trace(tmp_path / name), told)


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("boom_command", 'V are 100 %, such as unit = "V", factor = 0.1 in p.toml'),
        ("swing_command", 'V are 100 %, such as unit = "V", factor = 0.1 in p.toml'),
        ("payload_mass", 'kg are 100 %, such as unit = "kg", factor = 1 in p.toml'),
    ],
)
def test_a_share_of_a_command_needs_its_whole(system, name, entry):
    """A log in % tells nothing of the voltage: an entry of its description does."""
    trace = Trace(np.array([0.0, 1.0]), {name: np.array([0.0, 0.5])}, {name: "1"})
    told = rf"^p\.csv: column '{name}': unit '%' or '1': of a command say how many {entry}$"
    problem(lambda: drive(system, trace, "p.csv"), told)


def test_columns_with_names_of_their_own_are_to_be_described():
    """A near name is proposed; else a list of all signals would help nobody."""
    time = np.array([0.0, 1.0])
    run = Trace(time, dict.fromkeys(SIGNALS, time), {})

    def against(name, file="r.csv"):
        return lambda: check_comparable(run, Recording(time, {name: time}, {name: ""}, Path(file)))

    problem(against("Druck1", "r.csv"), "no signal Druck1 in the run; describe the columns: harvester desc")
    problem(against("swing_sped", "r.csv"), "did you mean manipulator.swing_speed")
    problem(against("Druck1", "r.toml"), "no signal Druck1 in the run; there are boom_stick.boom_head")


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ({"gain": 0.6}, "1 fault found: the swing valve opens too little for its command"),
        ({"gain": 1.5}, "1 fault found: the swing valve opens too much for its command"),
        (
            {"gain": 0.6, "leak": 5.0},
            "2 faults found: the boom hose leaks; the swing valve opens too little for its",
        ),
        (
            {"gain": 0.6, "hot": 1.0},
            "2 faults found: the oil is hot; the swing valve opens too little for its command",
        ),
    ],
)
def test_a_diagnosis_begins_with_the_fault(sizes, told):
    """In a sentence of a mechanic, the most certain one first; one without a sentence by its text."""
    end = "for its command"
    known = {
        "gain": (
            1.0,
            0.1,
            (f"the swing valve opens too little {end}", f"the swing valve opens too much {end}"),
        ),
        "leak": (0.0, 0.1, ("the boom hose leaks",)),
        "hot": (0.0, 0.0, ()),
    }
    findings = []
    for name, size in sizes.items():
        healthy, deviation, words = known[name]
        of = (np.array([v]) for v in (0.0, size, deviation, 1.0))
        findings.append(Finding(name, "The oil is hot", "1", name, *of, healthy, words))
    assert Diagnosis("log", findings, None, ()).verdict.startswith(told)
