"""Numbers: files are complete, consistent, sourced, and mistakes are told in one line."""

import math

import numpy as np
import pytest
from kit.equations import Part
from kit.mistakes import entry, problem, table

from fmus import boom_stick, swing
from fmus.contract import quantities, symbolic
from fmus.machine.parts import FERIC
from fmus.parameters import Number, numbers, read, read_parameter_set, rows, values, with_parameters, write

BOOM_STICK, MANIPULATOR, SWING = (FERIC.subsystems[n] for n in ("boom_stick", "manipulator", "swing"))


@pytest.mark.parametrize("sub", FERIC.subsystems.values(), ids=FERIC.subsystems)
def test_every_number_has_provenance(sub):
    """All parameters are there, each with unit, source and a note that says something."""
    found = numbers(sub)
    assert set(found["parameters"]) == set(quantities(sub.parameters))
    for section in found.values():
        for name, n in section.items():
            assert n.note, name
            if n.source == "paper":
                assert any(word in n.note for word in ("section", "eq.", "printed", "hose")), name


@pytest.mark.parametrize("sub", FERIC.subsystems.values(), ids=FERIC.subsystems)
def test_write_then_read_gives_the_same_numbers(sub, tmp_path):
    """The writer is the inverse of the reader, to the last bit."""
    found = numbers(sub)
    write(tmp_path / "p.toml", found)
    assert read(tmp_path / "p.toml") == found


def test_numbers_that_stand_in_two_files_are_the_same():
    """In each fidelity the valves of section 3(b), the oil and the supply; the strokes of the manipulator."""
    for variant, least in (("lumped", 12), ("quasistatic", 12), ("detailed", 20), ("compensated", 12)):
        one, other = (values(family.VARIANTS[variant]) for family in (swing, boom_stick))
        shared = set(one.p) & set(other.p) - {"initial_preload"}
        assert len(shared) > least
        assert {n: one.p[n] for n in shared} == {n: other.p[n] for n in shared}
        assert one.u["supply_pressure"] == other.u["supply_pressure"]
    manipulator, drives = (values(sub).p for sub in (MANIPULATOR, BOOM_STICK))
    assert all(manipulator[name] == drives[name] for name in ("boom_stroke", "stick_stroke"))


@pytest.mark.parametrize(
    "sub", [*swing.VARIANTS.values(), *boom_stick.VARIANTS.values()], ids=lambda s: s.name
)
def test_a_measured_number_of_a_hose_replaces_the_derived_one(sub):
    """In every variant: the numbers that length and bore lead to may be given, and then do the same."""
    given, free = values(sub), values(sub, derive=False)
    names = [n for n in given.p if free.p[n] == 0 != given.p[n]]
    assert names or sub.name == "swing_detailed"
    model = symbolic(sub).function()
    x = [q.nominal * 0.3 for q in quantities(sub.states).values()]
    u = [q.nominal * 0.2 for q in quantities(sub.inputs).values()]

    def rates(p):
        return model(x, u, list(p.values()))[0].full()

    # exact identity: the same formulas, in Python and in the equations
    np.testing.assert_allclose(rates(given.p), rates(free.p), rtol=1e-12)
    longer = {n: 1.3 * v if n.endswith("_length") else v for n, v in free.p.items()}
    assert not np.allclose(rates(longer), rates(free.p), rtol=1e-3)


# as the notes of the parameters state them, to their last digit
PRINTED = {
    "boom_hose_inertance": 1.021e7, "boom_hose_capacitance": 5.344e-13, "boom_hose_resistance": 3.018e10,
    "stick_hose_inertance": 1.361e7, "stick_hose_capacitance": 7.126e-13, "stick_hose_resistance": 4.024e10,
    "line_inertance": 3.403e6, "line_capacitance": 3.031e-13, "line_resistance": 6.19e6,
}  # fmt: skip


def test_length_and_bore_lead_to_the_printed_numbers():
    """Of oil of 970 kg/m3 and 1.6e9 Pa, to the digits printed: the formula and the print are two routes."""
    known = values(SWING).p | values(BOOM_STICK).p
    for name, number in PRINTED.items():
        digits = 2 if name == "line_resistance" else 3  # behind the point, of the printed number
        assert float(f"{known[name]:.{digits}e}") == number, name


def test_only_what_follows_from_paper_numbers_is_called_derived():
    """A length, mass or viscosity that somebody chose makes what follows from it assumed, not FERIC data."""
    derived = {
        name
        for s in FERIC.subsystems.values()
        for name, n in numbers(s)["parameters"].items()
        if n.source == "derived"
    }
    assert derived == {"stick_hose_inertance", "stick_hose_capacitance"}  # 4 m, 3/4 in, rho, beta


def test_formulas_named_in_notes_give_the_numbers():
    """Bars m l^2 / 12; Merritt's transition between a round opening and a slit."""
    m, s = values(MANIPULATOR).p, values(SWING).p
    # rounded to two or three digits
    assert m["boom_inertia"] == pytest.approx(m["boom_mass"] * 3.6**2 / 12, rel=2e-3)
    assert m["stick_inertia"] == pytest.approx(m["stick_mass"] * 2.9**2 / 12, rel=2e-3)
    round_opening, slit = ((s["valve_discharge_coefficient"] / delta) ** 2 for delta in (0.2, 0.157))
    assert round_opening < s["valve_transition_reynolds"] < slit
    assert (round_opening, slit) == pytest.approx((9.6, 15.6), abs=0.05)  # as the note says


def test_start_values_of_the_parts_belong_to_one_pose():
    """What boom_stick and manipulator start from when alone is x(q) and G(q)/J of the nominal pose."""
    arm, start = Part(MANIPULATOR), values(BOOM_STICK).u
    _, y = arm(arm.start())
    for joint in ("boom", "stick"):
        # stated with nine digits
        assert start[f"{joint}_position"] == pytest.approx(y[f"{joint}_position"], rel=1e-8)
        assert start[f"{joint}_holding_force"] == pytest.approx(y[f"{joint}_holding_force"], rel=1e-8)
        assert arm.u[f"{joint}_force"] == start[f"{joint}_holding_force"]


def test_printed_hose_resistance_is_read_as_a_reciprocal_near_blasius():
    """3.2e10 lies inside the Blasius band of eq. (10), 3.1e11 does not (docs/equations.md, section 1)."""
    diameter, rho = 0.75 * 0.0254, 970.0
    alpha = 0.3164 / 2 * (4 / math.pi) ** 1.75

    def blasius(flow, viscosity):
        return alpha * viscosity**0.25 * rho**0.75 * 4 / diameter**4.75 * flow**-0.25

    low, high = blasius(300 / 6e4, 0.008), blasius(60 / 6e4, 0.030)
    assert low < values(BOOM_STICK).p["stick_hose_resistance"] < high < 3.125e11 / 5


@table(__file__, "wrong", "name, change, message")
def test_mistakes_in_a_file_name_file_entry_expected_and_found(tmp_path, name, change, message):
    """A wrong unit, a missing, unknown, impossible or non-finite number is refused by name."""
    found = {section: dict(entries) for section, entries in numbers(SWING).items()}
    found["parameters"].pop(name, None)
    if change:
        found["parameters"][name] = Number(*change, "assumed", "a test")
    write(tmp_path / "p.toml", found)
    problem(lambda: numbers(SWING, tmp_path / "p.toml"), message)


@table(__file__, "broken", "text, message")
def test_a_broken_file_is_refused_in_one_line(tmp_path, text, message):
    """Syntax, tables and keys are checked before any number is used."""
    path = tmp_path / "p.toml"
    path.write_text(text)
    assert str(path) in problem(lambda: read(path), message)


TABLE = entry(__file__, "table")


def test_a_list_replaces_all_entries(tmp_path):
    """A parameter set with a shorter list sets its entries and zeros behind them, for all parts or one."""
    (tmp_path / "p.toml").write_text(
        TABLE.format(name="valve_pa_commands", value=[0.5, 2.0, 10.0])
        + TABLE.format(name='"swing.valve_pa_commands"', value=[0.7, 9.0])
    )
    chosen = read_parameter_set(tmp_path / "p.toml", [SWING, BOOM_STICK])
    for sub, expected in ((SWING, [0.7, 9.0]), (BOOM_STICK, [0.5, 2.0, 10.0])):
        point = Number(5.0, "V", "assumed", "a test")
        long = with_parameters(sub, {f"valve_pa_command_{i}": point for i in (3, 9)})
        found = numbers(with_parameters(long, chosen))["parameters"]
        assert [found[f"valve_pa_command_{i}"].value for i in range(1, 11)] == [*expected, *[0.0] * 10][:10]
        assert list(rows({n: x for n, x in found.items() if "pa_command" in n})) == ["valve_pa_commands"]


@table(__file__, "lists", "value, message")
def test_mistakes_in_lists_are_told(tmp_path, value, message):
    """Too many entries, text and values out of bounds are refused with the name."""
    (tmp_path / "p.toml").write_text(TABLE.format(name="valve_pa_commands", value=value).replace("'", '"'))
    problem(lambda: read_parameter_set(tmp_path / "p.toml", [SWING]), message)


def test_an_entry_of_another_source_has_a_row_of_its_own():
    """One point that is identified is not shown under the source of the others."""
    point = {"valve_pa_opening_3": Number(0.2, "1", "identified", "a test", 0.01)}
    shown = rows(numbers(with_parameters(SWING, point))["parameters"])
    assert shown["valve_pa_opening_3"][0].source == "identified"
    assert "valve_pa_openings" not in shown
    assert len(shown["valve_at_openings"]) == 10


def test_a_parameter_set_is_converted(tmp_path):
    """As values of --set are, with their standard deviation; another quantity is refused."""
    path = tmp_path / "crane.toml"
    entry = '[parameters.{}]\nvalue = {}\nsd = 5\nunit = "{}"\nsource = "assumed"\nnote = "a drawing"\n'
    path.write_text(entry.format("stick_length", 4200, "mm"), encoding="utf-8")
    number = read_parameter_set(path, FERIC.subsystems.values())["stick_length"]
    # one multiplication each
    assert (number.value, number.sd, number.unit) == (pytest.approx(4.2), pytest.approx(5e-3), "m")
    path.write_text(entry.format("stick_length", 4200, "kg"), encoding="utf-8")
    told = problem(lambda: read_parameter_set(path, FERIC.subsystems.values()))
    assert (
        told == f"{path}: [parameters.stick_length]: unit 'kg' cannot be converted, expected a unit like 'm'"
    )
