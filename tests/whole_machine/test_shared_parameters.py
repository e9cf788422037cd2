"""Values that parts share, and bounds of values: one line before the run."""

from dataclasses import replace

import pytest
from kit import mistakes

from fmus.contract import quantities
from fmus.machine.parts import FAMILIES, FERIC
from fmus.parameters import values
from orchestrator import assemble, load, run
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import FmuInterface
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.system import Component, System
from orchestrator.ssp.write import write_ssp

SSV = """<ParameterSet xmlns="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0"
 name="p"><Parameters><Parameter name="{}"><Real value="{}"/></Parameter></Parameters></ParameterSet>"""


def test_shared_parameters_are_declared_with_one_value():
    """By a variant of each part that shares it."""
    for name, parts in FERIC.shared.items():
        variants = [s for part in parts for s in FAMILIES[part].values()]
        declared = [s for s in variants if name in quantities(s.parameters)]
        assert {s.component for s in declared} == set(parts)
        assert len({values(s).p[name] for s in declared}) == 1


@pytest.mark.parametrize("part", ["boom_stick", "manipulator"])
def test_one_of_two_shared_values_is_refused(system, part):
    """The line names both and the name that sets both."""
    first, second = (0.6, 0.61) if part == "boom_stick" else (0.61, 0.6)
    told = f"boom_stick.boom_stroke is {first} and manipulator.boom_stroke is {second} m: expected one value"
    told += " of one physical quantity; set both at once by the name boom_stroke"
    assert mistakes.problem(lambda: system.with_start({f"{part}.boom_stroke": 0.6})) == told


def test_the_name_of_a_shared_value_sets_all_parts(system):
    """As do both names together."""
    both = {"boom_stick.boom_stroke": 0.6, "manipulator.boom_stroke": 0.6}
    for given in ({"boom_stroke": 0.6}, both):
        changed = system.with_start(given)
        assert [changed.components[p].value("boom_stroke") for p in FERIC.shared["boom_stroke"]] == [0.6, 0.6]


def test_parameter_sets_that_are_refused(system, tmp_path):
    """At the run, because another set may set the other value; out of bounds the line names the file."""
    file = tmp_path / "longer.ssv"
    file.write_text(SSV.format("boom_stick.boom_stroke", 0.6))
    told = r"boom_stick.boom_stroke is 0.6 and manipulator.boom_stroke is 0.61 m"
    mistakes.problem(lambda: run(system, parameters=[file], stop=0.01), told)
    with_sets(system, [file]).with_start({"boom_stroke": 0.6})
    file = tmp_path / "bad.ssv"
    file.write_text(SSV.format("boom_stick.boom_bore", 0))
    told = r"bad.ssv: boom_stick.boom_bore: expected at least 0.001 m, got 0 m"
    mistakes.problem(lambda: with_sets(system, [file]), told)


def test_an_ssp_keeps_what_its_parts_share(system, tmp_path):
    """Written, read, and without a part whose FMU lacks the parameter."""
    again = load(write_ssp(system, tmp_path / "again.ssp"))
    assert dict(again.shared) == dict(system.shared) == FERIC.shared
    both = ["boom_stick.boom_stroke", "manipulator.boom_stroke"]
    assert [str(port) for port in again.sharing("boom_stroke")] == both
    assert again.sharing("boom_bore") == []


def test_a_swapped_part_may_use_a_shared_name_for_something_else(system):
    """An output, or a parameter of another dimension, is no shared parameter."""
    part = system.components["manipulator"]
    declared = part.interface.variables["boom_stroke"]
    mass = replace(declared.unit, name="kg", exponents=(1, *[0] * (len(declared.unit.exponents) - 1)))
    for change in ({"causality": "output", "variability": "continuous"}, {"unit": mass}):
        variables = {**part.interface.variables, "boom_stroke": replace(declared, **change)}
        interface = replace(part.interface, variables=variables)
        swapped = replace(part, interface=interface, replaced=part.interface)
        other = replace(system, components={**system.components, "manipulator": swapped})
        assert [str(port) for port in other.sharing("boom_stroke")] == ["boom_stick.boom_stroke"]
        other.with_start({"boom_stick.boom_stroke": 0.6})


def test_shared_values_of_few_digits_are_equal(system):
    """Other tools write 6 to 9 digits; a message about other values shows the difference."""
    system.with_start({"boom_stick.boom_stroke": 0.6, "manipulator.boom_stroke": 0.6 + 1e-7})
    far, told = {"manipulator.boom_stroke": 0.600002}, r"is 0\.6 and manipulator.boom_stroke is 0\.600002 m"
    mistakes.problem(lambda: system.with_start({"boom_stick.boom_stroke": 0.6} | far), told)


def test_an_assembled_system_shares_what_it_is_told(fmu_dir):
    """`assemble` knows no names; without `shared` the values are independent."""
    fmus = {name: fmu_dir / f"{name}.fmu" for name in ("boom_stick", "manipulator")}
    assemble(fmus, start={"boom_stick.boom_stroke": 0.6})
    given = {"start": {"boom_stick.boom_stroke": 0.6}, "shared": {"boom_stroke": tuple(fmus)}}
    mistakes.problem(lambda: assemble(fmus, **given), "expected one value of one physical quantity")


@pytest.mark.parametrize(
    ("given", "who"),
    [
        ({"supply.oil_viscosity_100": 8.2e-6}, ("swing.oil_viscosity_100 is 6.8e-06", "supply.oil")),
        ({"boom_stick.bulk_modulus": 1.2e9}, ("swing.bulk_modulus is 1.6e+09", "boom_stick.bulk")),
        ({"swing.density": "870 kg/m3"}, ("swing.density is 870", "boom_stick.density is 970 kg/m3")),
        ({"density": 870.0}, ()),
        ({f"{p}.oil_viscosity_40": 32e-6 for p in ("swing", "boom_stick", "supply")}, ()),
    ],
)
def test_parts_with_another_oil_are_noted(system, tmp_path, given, who):
    """One note names two of them and the name that sets all, also of a system that was written and read."""
    again = load(write_ssp(replace(system, common=FERIC.oil), tmp_path / "again.ssp"))
    assert dict(again.common) == FERIC.oil
    notes = [n for n in run(again, set=given, stop=2e-3).card.notes if "one physical quantity" in n]
    assert len(notes) == bool(who)
    assert all(part in notes[0] for part in who)


@mistakes.table(__file__, "not_shared", "name, reason")
def test_what_cannot_be_shared_is_refused(name, reason):
    """In one line, before any value is compared; so is a component that does not exist."""
    variables = (
        FmuVariable("factor", causality="parameter", starts=("1",)),
        FmuVariable("bare", causality="parameter"),
        FmuVariable("text", "String", "parameter", starts=("a",)),
        FmuVariable("y", causality="output", starts=("1",)),
    )
    part = Component("a", FmuInterface({v.name: v for v in variables}))
    System("s", {"a": part}, shared={"factor": ("a",)}).check_sharing()
    expected = f"shared parameter {name}: expected a numeric parameter with a start value in a, got {reason}"
    system = System("s", {"a": part}, shared={name: ("a",)})
    assert mistakes.problem(system.check_sharing).startswith(expected)
    system.check_shared()  # such as after a swap: not compared
    other = System("s", {"a": part}, shared={"factor": ("a", "b")})
    mistakes.problem(other.check_sharing, "start value in b, got no such component")


@mistakes.table(__file__, "bounds", "given, message")
def test_values_out_of_bounds_are_refused_before_the_first_step(fmu_dir, tmp_path, capsys, given, message):
    """Limits in the model description by the importer, relations between parameters by the FMU."""
    out = tmp_path / "a.csv"
    arguments = ["run", fmu_dir / "harvester.ssp", "--set", given, "--out", out]
    assert message in mistakes.refused(capsys, arguments)
    assert not out.exists()
