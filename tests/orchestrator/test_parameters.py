"""Parameter sets of a user: from a file or by name from the SSP, with units; they override bound ones."""

from pathlib import Path

import numpy as np
import pytest
from kit.any_fmu.edit import edited
from kit.mistakes import problem, table

from orchestrator import assemble, load, run

COMMON = "http://ssp-standard.org/SSP1/SystemStructure"
SSD = f"""<SystemStructureDescription xmlns="{COMMON}Description" version="1.0" name="s"><System name="s">
<ParameterBindings><ParameterBinding source="resources/plain.ssv"/></ParameterBindings><Elements>
<Component name="g" source="resources/gain.fmu"/></Elements></System></SystemStructureDescription>"""


def ssv(unit="", base='m="1" factor="0.001"', **values):
    """The text of a parameter set, with the definition of its unit; in the names "__" stands for the dot."""
    written = unit and f"unit={unit!r}"
    rows = "".join(
        f'<Parameter name="{n.replace("__", ".")}"><Real value="{v}" {written}/></Parameter>'
        for n, v in values.items()
    )
    units = f'<c:Unit name="{unit}"><c:BaseUnit {base}/></c:Unit>' if unit else ""
    return (
        f'<ParameterSet xmlns="{COMMON}ParameterValues" xmlns:c="{COMMON}Common" version="1.0" name="p">'
        f"<Parameters>{rows}</Parameters>{units and f'<Units>{units}</Units>'}</ParameterSet>"
    )


@pytest.fixture
def system(fmus, zip_ssp):
    """A gain in an SSP with two sets, one of which is bound."""
    files = {"gain.fmu": fmus["gain"], "plain.ssv": ssv(g__factor=2.0), "steep.ssv": ssv(g__factor=9.0)}
    return load(zip_ssp(SSD, {f"resources/{name}": content for name, content in files.items()}))


def factor(system, **options):
    """The factor of the gain."""
    return run(system, step=0.5, stop=0.5, **{"set": {"u": 1.0}} | options).trace["g.y"][-1]


def test_a_set_of_the_ssp_wins_over_the_bound_one(system):
    """Later sets override earlier ones, and single values override all."""
    assert factor(system) == 2.0
    assert factor(system, parameters=["steep"]) == 9.0
    assert factor(system, parameters=["steep", "plain"]) == 2.0
    assert factor(system, parameters=["steep"], set={"u": 1.0, "g.factor": 4.0}) == 4.0


def test_a_set_of_an_unpacked_ssp(fmus, tmp_path):
    """The folder resources/ next to the .ssd file; the path has a space."""
    folder = tmp_path / "un packed"
    (folder / "resources").mkdir(parents=True)
    (folder / "SystemStructure.ssd").write_text(SSD, encoding="utf-8")
    (folder / "resources" / "gain.fmu").write_bytes(fmus["gain"].read_bytes())
    for name, value in (("plain", 2.0), ("steep", 9.0)):
        (folder / "resources" / f"{name}.ssv").write_text(ssv(g__factor=value), encoding="utf-8")
    for path in (folder, folder / "SystemStructure.ssd"):
        assert factor(load(path), parameters=["steep"]) == 9.0


def test_a_file_with_units_for_an_assembled_system(fmus, tmp_path):
    """Millimetres become the variable's metres; a bare name means every input of that name."""
    metres = {name: fmus.make("gain", f"gain_in_{name}", units={"u": "m"}) for name in ("p", "q")}
    file = tmp_path / "own.ssv"
    file.write_text(ssv("mm", u=500.0), encoding="utf-8")
    trace = run(assemble(metres), parameters=[file], step=0.5, stop=0.5).trace
    np.testing.assert_allclose([trace["p.u"], trace["q.u"]], 0.5, rtol=1e-15)  # one product, rounding only


def test_the_unit_is_converted_before_a_value_is_mapped(fmus, zip_ssp, tmp_path):
    """By a binding, and from an input of the system on: for a bound set, a chosen one, and a single value."""
    celsius = {"unit": "degC", "base": 'K="1" offset="273.15"'}
    fmu = fmus.make("gain", "warm", units={"u": "K"})
    files = {"resources/gain.fmu": fmu, "resources/bound.ssv": ssv(**celsius, command=20.0, air=20.0)}
    system = load(zip_ssp(Path(__file__).with_suffix(".ssd").read_text(encoding="utf-8"), files))
    # 20 degC = 293.15 K, times 2 plus 1; rounding only
    for component in system.components.values():
        assert component.start["u"] == pytest.approx(587.3, rel=1e-15)
    start = system.with_start({"command": "25 degC"}).components["g"].start
    assert start["u"] == pytest.approx(597.3, rel=1e-15)
    (tmp_path / "own.ssv").write_text(ssv(**celsius, command=30.0), encoding="utf-8")
    trace = run(system, parameters=[tmp_path / "own.ssv"], step=0.5, stop=0.5).trace
    np.testing.assert_allclose((trace["g.u"], trace["h.u"]), [[607.3] * 2, [587.3] * 2], rtol=1e-15)


def test_a_connected_input_may_stand_in_a_set(fmus, tmp_path):
    """Some tools need it at initialisation; here the source of the input overrides it."""
    file = tmp_path / "own.ssv"
    file.write_text(ssv(q__u=7.0, p__u=3.0), encoding="utf-8")
    chain = assemble({"p": fmus["gain"], "q": fmus["gain"]}, ["p.y -> q.u"])
    assert run(chain, parameters=[file], step=0.5, stop=0.5).trace["q.u"][0] == 3.0


@table(__file__, "mistakes", "name, message")
def test_sets_that_do_not_fit_are_refused(system, tmp_path, monkeypatch, name, message):
    """In one line: the set or file, the variable, expected and got."""
    monkeypatch.chdir(tmp_path)
    files = {"odd": {"g__fctor": 1}, "output": {"g__y": 1}, "text": {"g__factor": "x"}, "bare": {"u": "x"}}
    for file, values in files.items():
        (tmp_path / f"{file}.ssv").write_text(ssv(**values), encoding="utf-8")
    problem(lambda: run(system, parameters=[name]), message)


def test_a_system_without_sets_says_so(fmus):
    """A single FMU has none."""
    told = r"parameter set 'steep' is unknown; .* contains none"
    problem(lambda: run(str(fmus["gain"]), parameters=["steep"]), told)


def test_a_value_of_an_ssp_outside_its_limits_can_be_corrected(fmus, zip_ssp, tmp_path):
    """The final values count: the SSP loads, a run without a correction is refused with all digits."""
    limit = (r'(name="factor"[^>]*>\s*<Real)', r'\1 max="1.5708"')
    gain = edited(fmus["gain"], tmp_path / "gain.fmu", limit)
    files = {"resources/gain.fmu": gain, "resources/plain.ssv": ssv(g__factor=1.57080000001)}
    system = load(zip_ssp(SSD, files))
    got = r"SystemStructure\.ssd: g\.factor: expected at most 1\.5708, got 1\.57080000001"
    problem(lambda: run(system, step=0.5, stop=0.5), got)
    assert factor(system, set={"u": 1.0, "g.factor": 1.5}) == 1.5
