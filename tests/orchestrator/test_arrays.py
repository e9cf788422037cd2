"""Arrays of FMI 3.0: elements are signals; FMUs take them whole. By closed forms, with the FMU of bank.c."""

import tracemalloc
import zipfile

import numpy as np
import pytest
from kit.any_fmu.description import packed
from kit.any_fmu.models import bank_fmu
from kit.mistakes import problem
from kit.ssp import bound, connector, inline, second, ssd, system, wire

from orchestrator import Coupling, Trace, assemble, linearize, load, reference, run, write_ssp

STEP, STOP = 0.1, 1.0
ROUNDING = 1e-13  # of sums of a few terms of order 1
BOTH = pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])


@pytest.fixture(scope="session")
def bank(once):
    """The FMU of bank.c."""

    return once("bank", lambda folder: bank_fmu(folder / "bank.fmu")) / "bank.fmu"


def states(time, k, u):
    """x of x' = -k x + u from 0, shape (time, k)."""
    return (1 - np.exp(-np.outer(time, k))) / k * u


def of(name, count):
    return [f"{name}[{i}]" for i in range(1, count + 1)]


@BOTH
@pytest.mark.parametrize("n", [0, 1, 3, 5])
def test_sizes_follow_from_structural_parameters(bank, kind, n):
    """Matrices, states, event indicators and integers; also none. Lists set arrays whole."""
    k, u, m = np.arange(1.0, n + 1), np.linspace(1, 2, n), np.arange(2.0 * n).reshape(2, n)
    lists = {"bank.k": list(k), "bank.u": u, "bank.m": m} if n else {}
    given = {"bank.n": n, **lists, "bank.code": "5 6 7"}
    result = run(load(bank).in_kind(kind), set=given, step=STEP, stop=STOP)
    y = states(result.time, k, u) @ m.T
    # of the solver of Model Exchange, whose tolerance is 1e-8; Co-Simulation is exact
    np.testing.assert_allclose(np.transpose([result[f"bank.{name}"] for name in of("y", 2)]), y, atol=1e-7)
    assert [result[f"bank.{name}"][-1] for name in of("echo", 3)] == [5, 6, 7]
    assert [s for s in result if ".u[" in s] == of("bank.u", n)
    assert result.units["bank.y[1]"] == "m"


FIVE = {"bank.n": 5, "bank.k": "1 2 3 4 5", "bank.m": "1 1 1 1 1 0 0 0 0 1", "bank.u": "1 1 1 1 1"}


@pytest.mark.parametrize(
    ("before", "then", "k", "y"),
    [
        (FIVE, {"bank.n": 2}, [1, 2], [1, 1]),  # elements keep their values, others vanish
        ({"bank.n": 2, "bank.u": "1 1"}, {"bank.n": 3, "bank.u": "1 1 1"}, [1, 2, 3], [1, 1, 1]),
        ({"bank.n": 2, "bank.k": "3 4"}, {"bank.m": "1 1 0 0", "bank.u": "1 0"}, [3, 4], [1, 0]),
        ({"bank.size": 2, "bank.k": "3 4"}, {"bank.m": "1 1 0 0", "bank.u": "1 0"}, [3, 4], [1, 0]),
    ],
)
def test_sizes_change_more_than_once(tmp_path, before, then, k, y):
    """Start values of elements that are left stay; those of the FMU return with its sizes; also by a file."""
    alias = {'fixed" start="3"/>': 'fixed" start="3"><Alias name="size"/></UInt64>'}
    first = load(bank_fmu(tmp_path / "bank.fmu", alias)).with_start(before)
    write_ssp(first, tmp_path / "first.ssp")
    for sized_so in (first, load(tmp_path / "first.ssp")):
        result = run(sized_so, set=then, step=STEP, stop=STOP)
        exact = states(result.time, np.array(k), np.array(y)).sum(1)
        np.testing.assert_allclose(result["bank.y[1]"], exact, atol=ROUNDING * 10)


MASTERS = [Coupling(m) for m in ("jacobi", "gauss-seidel", "hermite", "interface-jacobian")]


@pytest.mark.parametrize("master", MASTERS, ids=lambda c: c.method.name)
def test_elements_are_coupled_like_scalars(bank, master):
    """A ring a -> b -> a through elements, a part of an array: against the whole system in one ODE."""
    ring = assemble({"a": bank, "b": bank}, ["a.y[1] -> b.u[2]", "b.y[2] -> a.u[3]"])
    given = {"a.u[1]": 1.0, "b.k[2]": 4.0, "a.m": "0.1 0.1 0.1 0 0 0"}
    found = run(ring, set=given, step=1e-3, stop=STOP, master=master)
    exact = reference(ring.in_kind("ModelExchange"), set=given, record_step=1e-3, stop=STOP)
    for name in (*of("a.y", 2), *of("b.y", 2)):  # of first order in the step
        np.testing.assert_allclose(found[name], exact[name], atol=1e-3)
    assert np.ptp(found["b.y[2]"]) > 0.01
    assert found["a.u[2]"].max() == found["b.u[3]"].max() == 0.0


def test_a_part_of_an_array_leaves_the_rest(bank):
    """A scenario drives one element, a wire another, --set the third, with a unit; in the same FMU."""
    pair = assemble({"a": bank, "b": bank}, ["a.y[1] -> b.u[1]"])
    scenario = Trace(np.array([0.0, 1.0]), {"b.u[2]": np.array([2.0, 2.0])})
    result = run(pair, scenario, set={"a.u": [1, 0, 0], "b.u[3]": "500 mm"}, step=1e-3, stop=STOP)
    x = states(result.time, np.array([2.0, 3.0]), np.array([2.0, 0.5]))
    np.testing.assert_allclose(result["b.y[2]"], x @ [1.0, 2.0], atol=ROUNDING * 1000)
    assert result["b.u[3]"][-1] == 0.5


def test_start_values_and_a_scenario_begin_together(bank):
    """The initialisation mode begins with all of them, and the FMU is not read before."""
    scenario = Trace(np.array([0.0, STOP]), {f"bank.u[{i}]": np.full(2, float(i)) for i in (1, 2)})
    for given in ({}, {"bank.u[3]": 4.0}):
        result = run(str(bank), scenario, set=given, step=STEP, record=of("bank.begin", 3))
        assert [result[name][0] for name in of("bank.begin", 3)] == [1, 2, given.get("bank.u[3]", 0)]


@pytest.mark.parametrize(("fed", "free"), [(1, 2), (2, 1)])
def test_a_part_of_a_resized_array_is_fed(tmp_path, fed, free):
    """The start values of the FMU are of another size; a wire feeds one element, --set gives the other."""
    other = bank_fmu(tmp_path / "bank.fmu", {'start="0" unit': 'start="0 0 0" unit'})
    pair = assemble({"a": other, "b": other}, [f"a.y[1] -> b.u[{fed}]"], {"b.n": 2, "b.k": "1 1"})
    result = run(pair, set={"b.m": "1 0 0 1", "a.u": "1 0 0", f"b.u[{free}]": 5.0}, step=STEP, stop=STOP)
    exact = states(result.time, [1.0], 5.0)[:, 0]
    np.testing.assert_allclose(result[f"b.y[{free}]"], exact, atol=10 * ROUNDING)
    assert result[f"b.y[{fed}]"][-1] > 0.1


def test_whole_arrays_are_wired(bank):
    """Equal shapes element by element; sizes before and after the wires; lines for others."""
    files = {"a": bank, "b": bank}
    told = problem(lambda: assemble(files, ["a.y -> b.u"]))
    assert told == "a.y -> b.u: expected equal shapes, got (2) and (3)"
    sized = {"b.n": 2, "b.k": "1 1", "b.m": "1 0 0 1"}
    pair = assemble(files, ["a.y -> b.u"], start=sized)
    assert [str(c) for c in pair.connections] == ["a.y[1] -> b.u[1]", "a.y[2] -> b.u[2]"]
    part = assemble(files, ["a.y[2] -> b.u[1]"]).with_start({"b.n": 1, "b.k": "1", "b.m": "1 1"})
    assert [str(c) for c in part.connections] == ["a.y[2] -> b.u[1]"]
    chain = assemble({"a": bank}, inputs={"w": ["a.u[3]"]}).with_start({"a.n": 2, "a.k": "1 1"})
    assert not chain.inputs
    told = problem(lambda: pair.with_start({"b.n": 1}))
    assert told == "a.y -> b.u: expected equal shapes, got (2) and (1)"
    assert "expected equal shapes, got (2) and a scalar" in problem(
        lambda: assemble(files, ["a.y -> b.u[1]"])
    )


BEGIN = {  # an output of n elements, the values of u at the start
    'valueReference="11" causality="local"': 'valueReference="11" causality="output"',
    '<InitialUnknown valueReference="7"/>': '<Output valueReference="11" dependencies=""/>'
    '<InitialUnknown valueReference="7"/><InitialUnknown valueReference="11"/>',
}


@pytest.mark.parametrize("n", [1, 2, 4])
def test_whole_wires_follow_sizes_that_are_set(tmp_path, n):
    """By set, in a file, and in two calls, as at assembly: u of a feeds b, of fewer or more."""
    files = dict.fromkeys("ab", bank_fmu(tmp_path / "bank.fmu", BEGIN))
    before = assemble(files, ["a.begin -> b.u"])
    k, u, m = np.arange(1.0, n + 1), np.linspace(1, 2, n), np.ones((2, n))
    sizes, values = (
        {"a.n": n, "b.n": n},
        {"a.u": u, **{f"{c}.{v}": x for c in "ab" for v, x in (("k", k), ("m", m))}},
    )
    file = write_ssp(before, tmp_path / "before.ssp")
    systems = [
        assemble(files, ["a.begin -> b.u"], {**sizes, **values}),
        before.with_start({**values, **sizes}),
        before.with_start(sizes).with_start(values),
        load(file).with_start({**values, **sizes}),
        before.with_start({"a.n": 5, "b.n": 5}).with_start({**sizes, **values}),
    ]
    for sized in systems:
        result = run(sized, step=STEP, stop=STOP)
        np.testing.assert_allclose(result["b.y[1]"], states(result.time, k, u).sum(1), atol=10 * ROUNDING)
        assert [str(c) for c in sized.connections] == [f"a.begin[{i}] -> b.u[{i}]" for i in range(1, n + 1)]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"bank.n": 2},
            "bank.k has the shape (2) now: expected start values of all its elements, got none of",
        ),
        ({"bank.k": "1 2"}, "bank.k: expected 3 values, got 2"),
        ({"bank.k": "1 2 x"}, "bank.k[3]: expected a value of type Real, got 'x'"),
        ({"bank.k[4]": 1}, "unknown variable 'bank.k[4]'"),
        ({"bank.code[2]": 2**40}, "expected a value in the range of Int32, got"),
        (
            {"bank.n": 20000},
            "bank.k: expected a number or text, got an array of shape (20000), of known sizes",
        ),
    ],
)
def test_mistakes_with_arrays_are_told(bank, given, message):
    """In one line with the array or the element."""
    if given == {"bank.n": 20000}:
        given = {**given, "bank.k": "1"}
    assert message in problem(lambda: run(str(bank), set=given, step=STEP, stop=STOP, isolate=False))


def test_declarations_must_fit(tmp_path):
    """As many start values as elements, or one for all; no negative size; the line names the file."""
    one = bank_fmu(tmp_path / "bank.fmu", {'start="1 2 3"': 'start="2"'})
    assert load(one).components["bank"].value("k[3]") == 2.0
    for change, message in (
        ({'start="1 2 3"': 'start="1 2"'}, "k: expected 3 start values, got 2"),
        ({'<Dimension start="3"/>': '<Dimension start="-3"/>'}, "expected dimensions of 0 or more, got (-3)"),
    ):
        file = bank_fmu(tmp_path / "bank.fmu", change)
        assert message in problem(lambda file=file: load(file))


LARGE = ('initial="exact" start="0"', 'derivative="4"')  # ends of the declarations of x and its derivative


def test_a_large_state_is_left_out_at_once(tmp_path):
    """No names of elements are made, which would take a minute and gigabytes."""
    large = {f'{of}><Dimension valueReference="1"/>': f'{of}><Dimension start="9000000"/>' for of in LARGE}
    file = bank_fmu(tmp_path / "bank.fmu", large)
    tracemalloc.start()
    interface = load(file).components["bank"].interface
    assert tracemalloc.get_traced_memory()[1] < 2**24  # bytes; a name for each element takes 60 times as many
    tracemalloc.stop()
    assert [*interface.unsupported] == ["x", "der(x)"]
    assert not interface.states


def test_elements_are_linearised(bank):
    """A, B, C of all elements, though an FMU takes seeds of whole arrays only; also of a part of them."""
    linear = linearize(load(bank), set={"bank.u": "1 1 1"})
    np.testing.assert_allclose(linear.a, np.diag([-1.0, -2.0, -3.0]), atol=ROUNDING)
    np.testing.assert_allclose(linear.c, [[1, 1, 1], [0, 1, 2]], atol=ROUNDING)


def test_names_with_dots_and_of_elements_do_everywhere(tmp_path):
    """Without their component: set, fault, until, accuracy_of, record, cut; also a whole array."""
    dots = bank_fmu(tmp_path / "dots.fmu", {'name="u"': 'name="sub.u"', 'name="y"': 'name="sub.frame.y"'})
    given = {"set": {"sub.u": "1 1 1"}, "step": 0.05}
    whole = run(str(dots), **given, record=["sub.frame.y", "sub.u[2]"])
    assert [*whole] == ["dots.sub.frame.y[1]", "dots.sub.frame.y[2]", "dots.sub.u[2]"]
    for name in ("sub.frame.y[1]", "y[1]", "dots.sub.frame.y[1]"):
        part = run(str(dots), **given, until=f"{name} > 0.5")
        assert part["sub.frame.y[1]"][-1] > 0.5 >= part["sub.frame.y[1]"][-2]
    assert run(str(dots), set=given["set"], accuracy=1e-2, accuracy_of=["frame.y[1]"]).reliable
    faulty = run(str(dots), **given, fault={"sub.u[1]": "2@0.5"})
    assert faulty["sub.u[1]"][-1] == 2.0
    pair = assemble(
        {"a": dots, "b": dots}, ["a.sub.frame.y[1] -> b.sub.u[1]", "a.sub.frame.y[2] -> b.sub.u[3]"]
    )
    assert [str(c.target) for c in pair.without("sub.u[1]").connections] == ["b.sub.u[3]"]
    assert not pair.without("sub.u").connections


# ---- SSP 2.0


def sized(name, kind, *sizes):
    """A connector with Dimensions; no size: any."""
    dimensions = "".join(f"<ssc:Dimension {size and f'size={size!r}'}/>" for size in sizes)
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Float64/>{dimensions}</ssd:Connector>'


def part(name, bindings="", size=""):
    ends = sized("u", "input", size) + sized("y", "output", "2")
    return f"""<ssd:Component name="{name}" source="bank.fmu"><ssd:Connectors>{ends}</ssd:Connectors>
{bindings}</ssd:Component>"""


def file(bank, folder, wires, bindings="", connectors="", size="", second_size=""):
    parts = [part("a", size=size), part("b", bindings, second_size)]
    text = second(ssd(system(parts, wires, connectors)))
    return packed(folder / "two.ssp", {"SystemStructure.ssd": text, "bank.fmu": bank.read_bytes()})


TWO = inline(
    ("n", '<ssv:Int32 value="2"/>'),
    ("k", '<ssv:Float64 value="1 1"/>'),
    ("m", '<ssv:Float64 value="1 0 0 1"/>'),
)


def test_arrays_of_a_file(bank, tmp_path):
    """Dimension, whole wires, lists and sizes in a parameter set, `endIndices`, arrays of the system."""
    ends = sized("w", "input", "3") + sized("v", "output") + connector("one", "input", "m")
    wires = [wire("w", "a.u"), wire("a.y", "b.u"), wire("b.y", "v")]
    one = load(file(bank, tmp_path, wires, TWO, ends.replace(connector("one", "input", "m"), "")))
    assert [*one.inputs] == of("w", 3)
    assert [*one.outputs] == of("v", 2)
    u = {f"w[{i}]": np.array([0.3 * i] * 2) for i in (1, 2, 3)}
    result = run(one, Trace(np.array([0.0, STOP]), u), step=1e-3, stop=STOP)
    u = np.array([0.3, 0.6, 0.9])
    y = states(result.time - 0.5, np.array([1.0, 2.0, 3.0]), u) @ [1, 1, 1]  # the file begins at 0.5 s
    np.testing.assert_allclose(result["a.y[1]"], y, atol=1000 * ROUNDING)  # a thousand steps
    np.testing.assert_array_equal(result["v[2]"], result["b.y[2]"])
    alone = load(file(bank, tmp_path, [wire("one", "a.u", extra='endIndices="2"')], "", ends))
    assert [str(port) for port, _ in alone.inputs["one"].targets] == ["a.u[2]"]


def same(system):
    """What a file of a system keeps."""
    ends = [(c.source, c.target, c.map) for c in system.connections]
    inputs, outputs = ({n: (e.unit, e) for n, e in of.items()} for of in (system.inputs, system.outputs))
    starts = {(n, v): x for n, c in system.components.items() for v, x in c.start.items()}
    return {(str(a), str(b), m) for a, b, m in ends}, str(inputs), str(outputs), starts


@pytest.mark.parametrize(
    ("wires", "connectors", "count"),
    [
        (["a.y -> b.u"], 5, 1),  # a: y and echo; b: y, echo and u
        (["a.y[1] -> b.u[2]", "a.y[2] -> b.u[1]"], 5, 2),  # exchanged
        (["a.y[2] -> b.u[2]"], 5, 1),
    ],
)
def test_an_array_is_one_connector_of_a_file(bank, tmp_path, wires, connectors, count):
    """With its Dimensions; whole wires are one connection, elements have indices; read back the same."""
    given = {"b.n": 2, "a.m": "1 2 3 4 5 6", "a.code": "1 2 3", "a.k[2]": 4.5}
    pair = assemble({"a": bank, "b": bank}, wires, given)
    file = write_ssp(pair, tmp_path / "pair.ssp")
    text = zipfile.ZipFile(file).read("SystemStructure.ssd").decode()
    assert (text.count("<ssd:Connector "), text.count("<ssd:Connection ")) == (connectors, count)
    assert 'value="1.0 2.0 3.0 4.0 5.0 6.0"/>' in text
    assert text.count('<ssc:Dimension size="2"/>') == 3  # y of both, u of b
    assert same(load(file)) == same(pair)
    scalars = write_ssp(pair, tmp_path / "scalars.ssp", version="1.0")  # SSP 1.0 has no arrays
    assert same(load(scalars)) == same(pair)


def test_arrays_of_a_system_are_written_as_such(bank, tmp_path):
    """Its inputs w and outputs v, and the scalar that feeds one element."""
    ends = sized("w", "input", "3") + sized("v", "output") + connector("one", "input", "m")
    wires = [wire("w", "a.u"), wire("one", "b.u", extra='endIndices="2"'), wire("b.y", "v")]
    before = load(file(bank, tmp_path, wires, "", ends))
    again = write_ssp(before, tmp_path / "again.ssp", version="2.0")
    text = zipfile.ZipFile(again).read("SystemStructure.ssd").decode()
    assert 'endConnector="u" endIndices="2"' in text
    assert text.count("<ssd:Connection ") == 3
    assert same(load(again))[:3] == same(before)[:3]  # a file has the start values of its inputs, too


def crossed(*ends, unit="m"):
    """Wires of the elements of w to other ones of a.u, and scalars of these names, the second in a unit."""
    wires = [wire(f"w[{k}]", "a.u", extra=f'endIndices="{end}"') for k, end in enumerate(ends, 1)]
    units = ["m", unit, "m"]
    return wires, "".join(connector(f"w[{k}]", "input", u) for k, u in enumerate(units, 1))


@pytest.mark.parametrize(
    ("wires", "ends", "scalars"),
    [
        (*crossed(1, 2, 3), 0),
        (*crossed(2, 1, 3), 3),
        (*crossed(1, 2, 3, unit="mm"), 3),
        ([wire("w", "a.u", extra='startIndices="1" endIndices="1"')], sized("w", "input", "3"), 1),
    ],
)
def test_elements_that_are_no_array_are_connectors_of_their_own(bank, tmp_path, wires, ends, scalars):
    """Crosswise, in several units, or alone: none of them is in an array w, and all are read back."""
    before = load(file(bank, tmp_path, wires, "", ends))
    again = write_ssp(before, tmp_path / "again.ssp", version="2.0")
    text = zipfile.ZipFile(again).read("SystemStructure.ssd").decode()
    assert (text.count('Connector name="w['), text.count('Connector name="w"')) == (scalars, not scalars)
    assert same(load(again))[:3] == same(before)[:3]


@pytest.mark.parametrize(
    ("wires", "more", "message"),
    [
        (
            ["w -> v"],
            {"connectors": sized("w", "input", "3") + sized("v", "output", "3")},
            "w -> v: expected a scalar",
        ),
        (["a.y -> b.u"], {}, "a.y -> b.u: expected equal shapes, got (2) and (3)"),
        (["a.y -> b.u"], {"bindings": TWO, "second_size": "3"}, "b.u: expected a Dimension for each size"),
        ([], {"bindings": inline(("k", '<ssv:Float64 value="1 2"/>'))}, "'k': expected 3 values, got 2"),
        ([], {"bindings": bound('source="no.ssv"')}, "no.ssv"),
    ],
)
def test_files_that_do_not_fit_are_told(bank, tmp_path, wires, more, message):
    """In one line."""
    ends = [wire(*pair.split(" -> ")) for pair in wires]
    assert message in problem(lambda: load(file(bank, tmp_path, ends, **more)))


def test_a_parameter_set_has_lists(bank, tmp_path):
    """Selected by the user: sizes first, whatever the order."""
    values = (
        '<ssv:Parameter name="bank.k"><ssv:Real value="4 5"/></ssv:Parameter>'
        '<ssv:Parameter name="bank.m"><ssv:Real value="1 0 0 1"/></ssv:Parameter>'
        '<ssv:Parameter name="bank.u"><ssv:Real value="1 1"/></ssv:Parameter>'
        '<ssv:Parameter name="bank.n"><ssv:Integer value="2"/></ssv:Parameter>'
    )
    text = f"""<ssv:ParameterSet version="1.0" name="p"
 xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"><ssv:Parameters>{values}
</ssv:Parameters></ssv:ParameterSet>"""
    (tmp_path / "two.ssv").write_text(text, encoding="utf-8")
    result = run(str(bank), parameters=[tmp_path / "two.ssv"], step=STEP, stop=STOP)
    # exact in Co-Simulation
    np.testing.assert_allclose(result["bank.y[2]"], states(result.time, [5.0], 1.0)[:, 0], atol=ROUNDING)
