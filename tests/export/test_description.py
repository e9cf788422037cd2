"""What an importer reads: modelDescription.xml, the layout of the archive, repeatable builds."""

import re
import zipfile

import casadi as ca
import fmpy
import fmpy.validation
import pytest
from export.conftest import TOYS, q, stateless
from kit.mistakes import problem, table

from fmus.export.build import build
from fmus.export.interface import dependencies, interface_of
from fmus.export.model_description import model_description
from fmus.parameters import Values, values
from fmus.sensors import sensors
from fmus.supply import SUPPLY
from fmus.swing import SWING
from orchestrator.base.files import Location
from orchestrator.fmi.interface import read_interface


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", TOYS)
def test_fmpy_finds_no_problem(unpacked, name, fmi):
    """FMPy finds no fault: schema, references, units, model structure."""
    assert fmpy.validation.validate_fmu(f"{unpacked[fmi, name]}.fmu") == []


@pytest.fixture(scope="module")
def chamber(toy_dir):
    """The model description of the chamber, which has variables of every kind."""
    return fmpy.read_model_description(str(toy_dir / "chamber.fmu"))


def test_variables_have_their_causality(chamber):
    """Each group of the declaration has its FMI causality, and state outputs are one variable."""
    kinds = {v.name: (v.causality, v.variability, v.initial) for v in chamber.modelVariables}
    assert kinds["volume"] == ("parameter", "fixed", "exact")
    assert kinds["supply"] == ("input", "continuous", "exact")
    assert kinds["pressure"] == ("output", "continuous", "calculated")
    assert kinds["heat"] == ("local", "continuous", "exact")
    assert kinds["der_heat"] == ("local", "continuous", "calculated")
    assert kinds["force"] == ("output", "continuous", "calculated")
    assert [v.name for v in chamber.modelVariables].count("pressure") == 1


def test_values_units_and_bounds_are_those_of_the_declaration(chamber):
    """Start, nominal, bounds, unit and display unit reach the XML."""
    v = {v.name: v for v in chamber.modelVariables}
    assert (v["volume"].start, float(v["volume"].min), v["volume"].unit) == ("0.0001", 1e-9, "m3")
    assert (float(v["opening"].min), float(v["opening"].max)) == (0.0, 1.0)
    assert (v["pressure"].unit, v["pressure"].displayUnit) == ("Pa", "bar")
    assert float(v["pressure"].nominal) == 1e7
    assert v["der_pressure"].unit == "Pa/s"
    bar = next(u for u in chamber.unitDefinitions if u.name == "Pa").displayUnits[0]
    # 1 / 1e5: rounding only
    assert (bar.name, bar.factor) == ("bar", pytest.approx(1e-5, rel=1e-15))


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_only_this_tool_knows_is_declared(tmp_path, fmi):
    """Optional inputs with their meaning and rates, held inputs, readings of sensors as noisy outputs."""

    def declared(sub):
        description = model_description(interface_of(sub, values(sub)), fmi, "token", 1e-3, 1.0)
        (tmp_path / "modelDescription.xml").write_bytes(description)
        return read_interface(Location(tmp_path))

    supply, drives = declared(SUPPLY), ("swing", "boom_stick")
    means = {f"{drive}_load_pressure": f"the load of {drive} is not sensed" for drive in drives}
    assert supply.model.optional_inputs == means
    assert supply.rate_inputs == {name: f"{name}_rate" for name in means}
    assert declared(SWING).model.held_inputs == {"oil_temperature"}
    model = declared(sensors({"pressure": "Pa", "angle": "rad"})).model
    assert model.noisy_outputs == {"pressure_measured", "angle_measured"}
    assert "pressure_bias" in model.optional_inputs


def test_dependencies_are_those_of_the_equations(chamber):
    """An unknown lists exactly the knowns that its equation contains."""
    found = {u.variable.name: u for u in [*chamber.outputs, *chamber.derivatives]}
    names = {name: [k.name for k in u.dependencies] for name, u in found.items()}
    assert names["pressure"] == ["pressure"]
    assert names["force"] == ["supply", "pressure"]
    assert names["der_flow"] == ["opening", "supply", "pressure", "flow"]
    kinds = dict(zip(names["der_flow"], found["der_flow"].dependenciesKind, strict=True))
    fixed = dict.fromkeys(("supply", "pressure"), "fixed")
    assert kinds == {"opening": "dependent", "flow": "dependent", **fixed}
    initial = {u.variable.name: [k.name for k in u.dependencies] for u in chamber.initialUnknowns}
    assert initial["pressure"] == ["supply"]
    assert initial["flow"] == ["conductance", "supply"]


def test_numbers_are_written_as_people_write_them(chamber):
    """Values are written as the shortest decimal of the same double, such as 1e-09."""
    numbers = [getattr(v, a) for v in chamber.modelVariables for a in ("start", "min", "max", "nominal")]
    written = [n for n in numbers if n is not None]
    assert len(written) > 5
    assert all(len(n) <= len(repr(float(n))) for n in written), written


def test_capabilities_are_declared(chamber):
    """The capability flags match the capabilities of the FMU."""
    for kind in (chamber.coSimulation, chamber.modelExchange):
        assert kind.canGetAndSetFMUstate
        assert kind.canSerializeFMUstate
        assert kind.providesDirectionalDerivative
        assert not kind.needsExecutionTool
        assert not kind.canBeInstantiatedOnlyOncePerProcess
    assert chamber.coSimulation.canHandleVariableCommunicationStepSize
    assert chamber.coSimulation.canInterpolateInputs
    assert chamber.coSimulation.maxOutputDerivativeOrder == 1
    assert (chamber.defaultExperiment.stepSize, chamber.defaultExperiment.stopTime) == ("0.01", "1")


def test_archive_holds_sources_and_documentation(toy_dir):
    """The FMU contains all C files, lists the one to compile, no other ends in .c, and there is a page."""
    with zipfile.ZipFile(toy_dir / "chamber.fmu") as archive:
        names = archive.namelist()
        page = archive.read("documentation/index.html").decode()
        xml = archive.read("modelDescription.xml").decode()
        code = archive.read("sources/chamber_fmu.c").decode()
    listed = set(re.findall(r'<File name="([^"]+)"', xml))
    included = set(re.findall(r'#include "(\w+\.c\.inc)"', code))
    assert listed == {"chamber_fmu.c"}
    assert {f"sources/{name}" for name in listed} == {n for n in names if n.endswith(".c")}
    assert {f"sources/{name}" for name in included} == {n for n in names if n.endswith(".inc")}
    assert len(included) > 10
    assert {"sources/model.h", "sources/sizes.h"} <= set(names)
    assert "<code>pressure_rate</code>" in page


def test_other_numbers_give_another_guid(toys, toy_dir, tmp_path):
    """Else the same name and the same equations."""
    sub, numbers = toys["gain"]
    other = build(sub, tmp_path, step=0.01, stop=1.0, values=Values({"factor": 3.0}, numbers.u, numbers.x))
    guids = {fmpy.read_model_description(str(f)).guid for f in (other, toy_dir / "gain.fmu")}
    assert len(guids) == 2


def test_name_declared_twice_is_refused(tmp_path):
    """An input with the name of a parameter causes an error that contains the name."""
    sub = stateless("twice", {"left": "1"}, {"y": "1"}, lambda *_: {"y": 0}, {"left": "1"})
    numbers = Values({"left": 1.0}, {"left": 1.0}, {})
    problem(lambda: build(sub, tmp_path, values=numbers), "left is declared twice")


# ---- What may stand in a model description: kinds of dependencies, names and numbers

STEPWISE = {
    "chosen": lambda u: ca.if_else(u > 0, 2, 3),
    "whole": lambda u: 3 * u + ca.floor(u),
    "signed": lambda u: 2 * ca.sign(u),
    "wrapped": lambda u: ca.fmod(u, 2),
}


def test_stepwise_dependency_has_no_factor():
    """An output that jumps with its input is "dependent", though its derivative is constant (2.2.8)."""
    y = dict.fromkeys([*STEPWISE, "straight", "scaled"], "1")

    def observe(_x, u, p):
        return {n: f(u.u) for n, f in STEPWISE.items()} | {"straight": 3 * u.u, "scaled": p.k * u.u}

    sub = stateless("steps", {"u": "1"}, y, observe, {"k": "1"})
    table = dependencies(interface_of(sub, Values({"k": 1.0}, {"u": 0.0}, {})))
    kinds = {name: [(v.name, kind) for v, kind in table[name]] for name in y}
    assert {n: kinds[n] for n in STEPWISE} == {n: [("u", "dependent")] for n in STEPWISE}
    assert (kinds["straight"], kinds["scaled"]) == ([("u", "constant")], [("u", "fixed")])


@table(__file__, "refused", "name, more, start, words")
def test_what_a_description_cannot_have_is_refused(name, more, start, words):
    """Nominal values that are not positive, starts out of bounds; a name that is none of a file and in C."""
    sub = stateless(name, {"u": q(**more)}, {"y": "1"}, lambda _x, u, _p: {"y": u.u})
    problem(lambda: interface_of(sub, Values({}, {"u": start}, {})), words)
