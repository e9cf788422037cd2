"""A system that is written as an SSP is the same system when it is read again."""

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.properties import examples

from orchestrator import Coupling, System, assemble, load
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, LinearTransformation
from orchestrator.ssp.coupling import Suggestion
from orchestrator.ssp.system import Connection, Inlet, Outlet, Port
from orchestrator.ssp.write import write_ssp

NUMBERS = st.floats(-1e9, 1e9, allow_subnormal=False)
# start values are divided by the factor, which overflows for smaller ones
FACTORS = NUMBERS.filter(lambda factor: abs(factor) > 1e-290)
MAPS = st.one_of(st.just(IDENTITY), st.builds(LinearTransformation, FACTORS, NUMBERS))
COUPLINGS = st.one_of(
    st.none(),
    st.builds(Coupling, st.sampled_from(("jacobi", "gauss-seidel")), st.sampled_from((None, 0, 2))),
    st.builds(
        lambda tolerance, factor: Coupling("hermite", tolerance=tolerance, factors={"p": factor}),
        st.floats(1e-9, 1.0),
        st.integers(1, 9),
    ),
    st.builds(lambda x: Coupling(adaptive=x), st.floats(1e-9, 1.0)),
)


@pytest.fixture(scope="module")
def gains(fmus):
    """Gains with pascals, with bars at the input, and with a unit that the FMU does not define."""
    units = {"plain": ("Pa", "Pa"), "mixed": ("bar", "Pa"), "odd": ("odd", "degC")}
    return [fmus.make("gain", f"{n}_units", units={"u": u, "y": y}) for n, (u, y) in units.items()]


@st.composite
def systems(draw, files) -> System:
    """Gains in any connection, with start values, inputs and outputs of the system."""
    names = ["p", "q", "inner.r"][: draw(st.integers(1, 3))]
    system = assemble({n: draw(st.sampled_from(files)) for n in names}, name="any")
    start = {
        n: {v: draw(NUMBERS) for v in draw(st.lists(st.sampled_from(["factor", "offset", "u"]), unique=True))}
        for n in names
    }
    connections, inputs = [], {}
    for name in names:
        target = Port(name, "u")
        kind = draw(st.sampled_from(["connected", "input", "open"]))
        if kind == "connected":
            connections.append(Connection(Port(draw(st.sampled_from(names)), "y"), target, draw(MAPS)))
        elif kind == "input":
            key = draw(st.sampled_from(["command", "other"]))
            unit = inputs[key].unit if key in inputs else system.variable(target).unit
            before = inputs[key].targets if key in inputs else ()
            inputs[key] = Inlet(key, unit, (*before, (target, draw(MAPS))))
    units = [system.variable(Port(n, v)).unit for n in names for v in "uy"]
    outputs = [Outlet(f"result_{n}", draw(st.sampled_from(units)), Port(n, "y"), draw(MAPS)) for n in names]
    return replace(
        system,
        components={n: replace(c, start=start[n]) for n, c in system.components.items()},
        connections=tuple(connections),
        inputs=inputs,
        outputs={o.name: o for o in draw(st.lists(st.sampled_from(outputs), unique=True))},
        start=draw(st.floats(-10, 10)),
        stop=draw(st.floats(11, 20)),
        suggestion=Suggestion(draw(COUPLINGS), draw(st.one_of(st.none(), st.floats(1e-6, 1.0)))),
    )


@examples(20)
@given(data=st.data(), version=st.sampled_from(("1.0", "2.0")))
def test_a_system_is_read_as_it_was_written(gains, tmp_path_factory, data, version):
    """To the last digit: all numbers are written so that they read back."""
    system = data.draw(systems(gains))
    read = load(write_ssp(system, tmp_path_factory.mktemp("ssp") / "any.ssp", version=version))
    assert (read.name, list(read.components)) == (system.name, list(system.components))
    assert Counter(read.connections) == Counter(system.connections)
    assert (read.start, read.stop) == (system.start, system.stop)
    assert read.inputs.keys() == system.inputs.keys()
    for name, inlet in system.inputs.items():
        assert Counter(read.inputs[name].targets) == Counter(inlet.targets)
        assert read.inputs[name].unit == inlet.unit
        for (component, variable), linear in inlet.targets[:1]:
            start = system.components[component].value(variable)
            # rounding of subtraction, division, multiplication and addition; underflow
            exact = pytest.approx(start, rel=0, abs=1e-15 * (abs(start) + abs(linear.offset)) + 1e-300)
            assert read.components[component].value(variable) == exact
    for name, outlet in system.outputs.items():
        unit = outlet.unit or system.variable(outlet.source).unit  # without one, that of its source
        assert read.outputs[name] == replace(outlet, unit=unit)
    for name, component in system.components.items():
        fed = {p for i in system.inputs.values() for p, _ in i.targets if p.component == name}
        started = read.components[name].start
        kept = {v: x for v, x in component.start.items() if Port(name, v) not in fed}
        assert {v: x for v, x in started.items() if Port(name, v) not in fed} == kept
    suggested = system.suggestion
    if suggested.coupling is not None or suggested.step is not None:
        assert (read.coupling, read.step) == (suggested.coupling or Coupling(), suggested.step)


RESOURCES = {"view.toml": b"title = 'bench'", "notes/readme.txt": b"measured in May", "cold.ssv": b"<a/>"}


@pytest.mark.parametrize("unpacked", [False, True])
def test_other_resources_are_written_again(gains, tmp_path, unpacked):
    """Files that belong to no component are kept, files of replaced or unpacked FMUs are not."""
    files = RESOURCES | {"signals.ssb": b"<a/>"}  # of earlier versions: signals of components
    first = write_ssp(assemble({"p": gains[0], "q": gains[1]}), tmp_path / "first.ssp", resources=files)
    if unpacked:
        Location(first).extract(tmp_path / "first")
        first = tmp_path / "first"
        old = first / "resources" / "old"
        old.mkdir()
        for name in ("modelDescription.xml", "model.bin"):
            (old / name).touch()
    system = load(first)
    system = replace(system, components={"p": system.components["p"]})
    second = write_ssp(system, tmp_path / "second.ssp", resources={"view.toml": b"title = 'other'"})
    kept = load(second).resources
    assert sorted(kept) == ["cold.ssv", "notes/readme.txt", "p.fmu", "view.toml"]
    assert kept["view.toml"].read() == b"title = 'other'"
    assert kept["notes/readme.txt"].read() == RESOURCES["notes/readme.txt"]
    assert load(gains[0]).resources == {}
