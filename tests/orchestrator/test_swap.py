"""Swaps: the choice of the new FMU, checks of its ports, and runs with it; the machine with other FMUs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kit.any_fmu.edit import caused, renamed
from kit.any_fmu.edit import edited as changed
from kit.mistakes import problem, refused, table

from orchestrator import Problem, assemble, load, run
from orchestrator.__main__ import main
from orchestrator.base.options import chosen
from orchestrator.base.units import LinearTransformation
from orchestrator.engine.options import RunOptions
from orchestrator.results.validate_system import Experiment, validate_system
from orchestrator.ssp.swap import with_swaps

SSD = Path(__file__).with_suffix(".ssd").read_text(encoding="utf-8")
SSV = """<ParameterSet version="1.0" name="p"><Parameters>
<Parameter name="g.offset"><Real value="5"/></Parameter></Parameters></ParameterSet>"""


def edited(fmu, name, *changes):
    """A changed copy of an FMU next to it."""
    return changed(fmu, fmu.with_name(f"{name}.fmu"), *changes)


@pytest.fixture
def bench(tmp_path, monkeypatch, fmus, zip_ssp):
    """A working directory with build/harvester.ssp around gain.fmu and two variants of it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "build/variants").mkdir(parents=True)
    files = {"resources/gain.fmu": fmus["gain"], "resources/high.ssv": SSV}
    zip_ssp(SSD, files, "build/harvester.ssp")
    for name in ("fine", "coarse"):
        (tmp_path / f"build/variants/g_{name}.fmu").write_bytes(fmus["gain"].read_bytes())
    return load("build/harvester.ssp")


def test_a_swapped_twin_gives_the_same_numbers(fmus, fmus3, oscillator):
    """Bit for bit, also with an FMI 3.0 FMU in a system of FMI 2.0; the card names model and file."""
    usual = run(oscillator, step=1e-3, stop=0.1).trace
    for workshop in (fmus, fmus3):
        result = run(oscillator, step=1e-3, stop=0.1, swap={"b": str(workshop["mass_b"])})
        assert result.trace == usual
        assert result.card.notes == (f"b is swapped: mass_b ({workshop['mass_b']})",)
        assert list(result.system.components) == ["a", "b"]
    assert oscillator.components["b"].replaced is None  # the given system is as it was


def test_variants_lie_beside_the_system(bench):
    """By name; a name that ends in .fmu is a path."""
    for variant in ("fine", "build/variants/g_coarse.fmu", Path("build/variants/g_coarse.fmu")):
        result = run(bench, step=0.5, stop=1.0, swap={"g": variant})
        np.testing.assert_array_equal(result.trace["result"], 2.0)
        assert "build/variants/g_" in result.card.notes[0]


@table(__file__, "choices", "swaps, message")
def test_a_choice_that_is_not_there_is_told(bench, oscillator, swaps, message):
    """The message lists the available names; there are none beside a system without a file."""
    assert message in problem(lambda: with_swaps(bench if "a" not in swaps else oscillator, swaps))


def test_convertible_units_are_converted(fmus):
    """On connections in and out, also with linear maps; the other components get the same values."""
    pascal = fmus.make("gain", "gain_pa", units={"u": "Pa", "y": "Pa", "offset": "Pa"})
    bar = fmus.make("gain", "gain_bar", units={"u": "bar", "y": "bar", "offset": "bar"})
    source = fmus.make("source", "source_pa", units={"y": "Pa", "offset": "Pa"})
    source_bar = fmus.make("source", "source_bar", units={"y": "bar", "offset": "bar"})
    wires = [("s.y", "g.u", 2.0, 1e5), "g.y -> end.u"]
    start = {"s.offset": 3e5, "s.amplitude": 0.0, "g.offset": 4e5}
    system = assemble({"s": source, "g": pascal, "end": pascal}, wires, start)
    result = run(system, step=0.5, stop=1.0, swap={"g": bar})
    # 2 * 3 bar + 1 bar, plus 4 bar; a few roundings
    np.testing.assert_allclose(result.trace["g.u"], 7.0, rtol=1e-14)
    np.testing.assert_allclose(result.trace["end.u"], 11e5, rtol=1e-14)
    other = run(system, step=0.5, stop=1.0, swap={"s": source_bar})
    np.testing.assert_allclose(other.trace["g.u"], 7e5, rtol=1e-14)
    units = "u in [bar], not [Pa], y in [bar], not [Pa], offset in [bar], not [Pa]"
    note = f"{bar} has other units, which are converted: {units}"
    assert f"{note}; values that you set keep the unit of the replaced FMU" in result.card.notes
    back = with_swaps(with_swaps(system, {"g": bar}), {"g": pascal})
    for c, usual in zip(back.connections, system.connections, strict=True):
        assert c.map(1e5) == pytest.approx(usual.map(1e5), rel=1e-14)


def test_given_values_stay_in_the_units_of_the_replaced_fmu(fmus):
    """Start values by name, also by a variable name that several components have."""
    pascal, bar = (fmus.make("gain", f"gain_{unit}", units={"u": unit}) for unit in ("Pa", "bar"))
    system = assemble({"g": pascal, "h": pascal})
    for name in ("u", "g.u"):
        trace = run(system, step=0.5, stop=1.0, swap={"g": bar}, set={name: 3e5}).trace
        np.testing.assert_allclose(trace["g.y"], 3.0, rtol=1e-15)  # one product, rounding only


def test_units_that_the_fmu_does_not_state_are_assumed(fmus, oscillator):
    """Those of the replaced FMU, with a note; the signals keep them."""
    bare = edited(fmus["mass_b"], "bare", (r' unit="[^"]*"', ""), ("<UnitDef.*UnitDefinitions>", ""))
    result = run(oscillator, step=1e-3, stop=0.1, swap={"b": bare})
    assert result.card.notes[1] == (f"{bare} declares no unit for force, x: that of the replaced FMU is used")
    assert result.trace.units["b.force"] == "N"


CHANGES = {"renamed": renamed, "caused": caused, "replaced": lambda *change: change}


@table(__file__, "faults", "changes, message")
def test_what_does_not_fit_is_told_in_one_line(fmus, oscillator, changes, message):
    """Component, file, port, expected, got; all faults together."""
    faulty = edited(fmus["mass_b"], "faulty", *(CHANGES[kind](*change) for kind, *change in changes))
    told = problem(lambda: with_swaps(oscillator, {"b": faulty}))
    assert told == f"swap b: {faulty} does not fit: {message}"


def test_an_input_that_an_fmu_does_not_use_may_be_missing(fmus, oscillator):
    """With a note; refused if another could be meant, with a way out; an additional input keeps its start."""
    loose = edited(fmus["mass_b"], "loose", renamed("force"), caused("other", "local"))
    other = edited(fmus["mass_b"], "other", renamed("force"))
    told = r"got none \(it has other; to do without: --cut b.force\)$"
    problem(lambda: with_swaps(oscillator, {"b": other}), told)
    alone = run(oscillator.without("b.force"), step=1e-3, stop=0.1, swap={"b": other})
    assert f"{other} has additional inputs, which are not connected: other" in alone.card.notes
    result = run(oscillator, step=1e-3, stop=0.1, swap={"b": loose})
    assert f"{loose} has no force: it does not use what the system would send there" in result.card.notes
    assert np.ptp(result.trace["b.x"]) > 0  # m: it swings by its own spring
    np.testing.assert_array_equal(result.trace["b.x"], alone.trace["b.x"])
    # no cut is suggested where power would be lost: without one of its two connections a bond is cut
    bond = assemble({"k": fmus["spring"], "b": fmus["mass_b"]}, ["b.v -> k.v", "k.force -> b.force"])
    problem(lambda: with_swaps(bond, {"b": other}), r"expected input force \[N\], got none$")


def test_rate_ports_may_be_missing(fmus):
    """For an input or an output the connection is left out, with a note about accuracy."""
    files = {"x": fmus["source"], "v": fmus.make("source", "speed", units={"y": "m/s"}), "d": fmus["drift"]}
    system = assemble(files, ["x.y -> d.u", "v.y -> d.u_rate"], {"x.amplitude": 0.0, "x.offset": 1.0})
    plain = edited(fmus["drift"], "plain", (' derivative="1"', ""), renamed("u_rate"))
    silent = edited(files["v"], "silent", renamed("y"))
    for name, fmu, port in (("d", plain, "u_rate"), ("v", silent, "y")):
        result = run(system, step=0.5, stop=1.0, swap={name: fmu})
        assert [str(c) for c in result.system.connections] == ["x.y -> d.u"]
        lost = f"{fmu} has no {port}: without these rates inputs are held during a step"
        assert lost in str(result.card.notes)


def test_a_rate_with_a_rate_of_its_own_is_needed(fmus):
    """Of position, velocity and acceleration only the last may be missing."""
    files = {"v": fmus.make("source", "speed", units={"y": "m/s"}), "g": fmus["glide"]}
    system = assemble(files, ["v.y -> g.velocity"])
    with pytest.raises(Problem, match=r"expected input velocity \[m/s\], got none"):
        with_swaps(system, {"g": edited(fmus["glide"], "plain", renamed("velocity"))})


def optional(fmu, name, port, *changes):
    """A copy of an FMU that declares an input as optional, and its states, none, by Model Exchange."""
    kind = "<ModelExchange modelIdentifier='gain'/><CoSimulation"
    said = f"<Inputs><OptionalInput input='{port}' without='{port} is not seen'/></Inputs>"
    told = f"<VendorAnnotations><Tool name='harvester-cosim'>{said}</Tool></VendorAnnotations>"
    return edited(fmu, name, ("<CoSimulation", kind), ("<ModelVariables>", rf"{told}\g<0>"), *changes)


def test_what_is_declared_as_optional_may_be_missing(fmus):
    """At either end, with its meaning in a note; it is a warning where it reaches a state elsewhere."""
    gain = optional(fmus["gain"], "seeing", "u")
    files = {"s": fmus["source"], "g": gain, "d": fmus["drift"]}
    wires = ["s.y -> g.u", "g.y -> d.u"]
    silent = edited(fmus["source"], "silent", renamed("y"))
    blind = edited(gain, "blind", renamed("u"))
    foreign = edited(gain, "foreign", ("<Inputs.*</Inputs>", ""))
    no_y, no_u = f"{silent} has no y: u is not seen", f"{blind} has no u: u is not seen"
    for ends, swaps, notes, warnings in (
        (wires, {"s": silent}, (), (f"{no_y}; d (drift) could use this signal",)),
        (wires[:1], {"s": silent}, (no_y,), ()),
        (wires, {"g": blind}, (no_u,), ()),
        (wires[:1], {"g": foreign, "s": silent}, (no_y,), ()),
    ):
        system = with_swaps(assemble(files, ends), swaps)
        assert [str(c) for c in system.connections] == ends[1:]
        assert [n for n in system.notes if "not seen" in n] == list(notes)
        assert system.warnings == warnings
        assert run(system, step=0.5, stop=1.0).card.warnings == warnings


def test_start_values_go_over_where_there_is_a_place(bench, fmus):
    """From the system and from a selected parameter set; a note lists values that are left out."""
    plain = edited(fmus["gain"], "plain", renamed("offset"))
    result = run(bench, step=0.5, stop=1.0, swap={"g": plain}, parameters=["high"], set={"command": 1.0})
    np.testing.assert_array_equal(result.trace["result"], 3.0)
    assert f"{plain} has no offset: the start values in the system are not used" in result.card.notes
    note = "build/harvester.ssp/resources/high.ssv: g.offset is left out: "
    assert any(n.startswith(note) for n in result.card.notes)
    with pytest.raises(Problem, match=r"unknown variable 'g.offset'"):
        run(bench, step=0.5, stop=1.0, swap={"g": plain}, set={"g.offset": 1.0})
    attributes = r'\1causality="calculatedParameter" variability="fixed" initial="calculated"><Real/>'
    change = r'(name="offset" [^>]*)causality="parameter"[^>]*><Real[^>]*/>', attributes
    computed = edited(fmus["gain"], "computed", change)
    told = str(run(bench, step=0.5, stop=1.0, swap={"g": computed}, parameters=["high"]).card.notes)
    assert f"{computed} computes offset itself: the start values in the system are not used" in told
    assert f"high.ssv: g.offset is left out: {computed} computes it itself" in told


def write(**files):
    """Write files of the working directory: name with _ for the dot -> text."""
    for name, text in files.items():
        Path(name.replace("_", ".")).write_text(text, encoding="utf-8")


def validated(reference="m.csv", scenario=None, default=("none.csv", "none.toml"), **options):
    """Validate the system of the bench; the reports go to out/. Returns the text of the card."""
    files = [name and Path(name) for name in (scenario, reference)]
    own = {name: options.pop(name) for name in [*options] if name in Experiment.__dataclass_fields__}
    system, options = Path("build/harvester.ssp").resolve(), options | {"step": 0.5}
    experiment = Experiment(
        system, tuple(map(Path, default)), *files, options=chosen(RunOptions, options, "run"), **own
    )
    return validate_system(experiment, Path("out"))[1]


RESULT = '[signals.result]\nunit = "m"\n'


@pytest.mark.usefixtures("bench")
def test_signals_that_a_swap_lost_are_not_compared(fmus):
    """A reference of the usual system may name them; one that neither has is a mistake."""
    plain = edited(fmus["gain"], "plain", renamed("offset"))
    meta, samples = f'{RESULT}[signals."g.offset"]\nunit = "m"\n', "time,result,g.offset\n0,0,2\n1,0,2\n"
    write(m_toml=meta, m_csv=samples)
    validated(swap={"g": str(plain)}, stop=1.0)
    report = json.loads(Path("out/report.json").read_text(encoding="utf-8"))
    assert "not compared, because they are not in the run: g.offset" in str(report)
    write(m_toml=meta.replace("offset", "ofset"), m_csv=samples.replace("offset", "ofset"))
    problem(lambda: validated(swap={"g": str(plain)}, stop=1.0), r"no signal g.ofset in the run")


@pytest.mark.usefixtures("bench")
def test_a_swapped_system_is_expected_to_differ_from_a_simulation():
    """Said in the terminal and on the first page of the report; a measurement is of no model."""
    made = 'title = "T"\norigin = "o"\nmade_by = "m"\nsolver = "s"\nrelative_tolerance = 1e-9\n'
    made += 'date = 2024-01-01\nchange = "c"\n'
    note = "g is swapped: the reference was computed with another model, so expect differences"
    for kind, expected in (("simulation", True), ("measurement", False)):
        write(m_toml=f'[reference]\nkind = "{kind}"\n{made}{RESULT}', m_csv="time,result\n0,2\n1,2\n")
        told = validated(swap={"g": "fine"}, stop=1.0)
        assert (f"note: {note}" in told) is expected
        page = Path("out/report.html").read_text(encoding="utf-8")
        assert (f">G{note[1:]}.</p>" in page) is expected
        assert "a simulation of the same equations" not in page


@pytest.mark.usefixtures("bench")
def test_a_scenario_without_reference_is_told_what_judges_it():
    """The usual reference is of another scenario."""
    write(m_toml=RESULT, m_csv="time,result\n0,2\n1,2\n", u_csv="time,command\n0,0\n1,0\n")
    write(l_toml='title = "T"')
    told = validated(None, "u.csv", default=("m.csv", "l.toml"))
    note = "no --reference given: judged against m.csv, which may have another scenario than u.csv"
    assert f"note: {note}" in told
    assert note in Path("out/report.json").read_text(encoding="utf-8")


@pytest.mark.usefixtures("bench")
def test_the_command_line_swaps(capsys, fmus):
    """By name, with notes on the card; the list of signals has the parameters of the new FMU."""
    assert main(["run", "--stop", "1", "--swap", "g=fine"]) == 0
    assert "note: g is swapped: gain (build/variants/g_fine.fmu)" in capsys.readouterr().out
    edited(fmus["gain"], "more", renamed("offset", "shift")).rename("more.fmu")
    assert main(["signals", "--kind", "parameter", "--swap", "g=more.fmu"]) == 0
    printed = capsys.readouterr().out
    assert "g.shift" in printed
    assert "g.offset" not in printed


def test_ports_of_the_system_are_checked_and_converted(bench, fmus):
    """Input and output of the outermost system; what an input of it feeds is needed, optional or not."""
    seeing = with_swaps(bench, {"g": optional(fmus["gain"], "seeing", "u")})
    blind, bare = (edited(fmus["gain"], f"no_{n}", renamed(n)) for n in "uy")
    problem(lambda: with_swaps(seeing, {"g": blind}), r"expected input u \[m\], got none")
    problem(lambda: with_swaps(bench, {"g": bare}), r"expected output y \[m\], got none$")
    units = ('unit="m"', 'unit="mm"'), ('name="m"><BaseUnit m="1"', 'name="mm"><BaseUnit m="1" factor="1e-3"')
    small = edited(fmus["gain"], "small", *units)
    linear, inlet = LinearTransformation(2.0, 1.0), bench.inputs["command"]
    inlet = replace(inlet, targets=tuple((port, linear) for port, _ in inlet.targets))
    outlet = replace(bench.outputs["result"], map=linear)
    mapped = replace(bench, inputs={"command": inlet}, outputs={"result": outlet})
    trace = run(mapped, step=0.5, stop=1.0, swap={"g": small}, set={"command": 4.0}).trace
    # 4 m, times 2 plus 1 m = 9000 mm, times 3 plus 2 m = 29 m, times 2 plus 1 m; a few roundings
    np.testing.assert_allclose(trace["g.u"], 9000.0, rtol=1e-14)
    np.testing.assert_allclose(trace["result"], 59.0, rtol=1e-14)


@pytest.mark.usefixtures("bench")
@table(__file__, "commands", "swap, message")
def test_mistakes_of_a_swap_are_one_line(capsys, fmus, swap, message):
    """No traceback, exit status 2, for `run` and `validate`."""
    Path("text.fmu").write_text("no zip", encoding="utf-8")
    Path("x.fmu").write_bytes(fmus["mass_a"].read_bytes())
    for command in ("run", "validate"):
        assert message in refused(capsys, [command, "--swap", *swap.split()])


# ---- the machine with other FMUs stays at rest

JOINTS = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
# Through closed valves oil leaks, 20 mL/min per edge, and the arm settles on it: 1.5e-4 rad/s at full reach.
# Pressures that do not fit the pose let it fall with nearly 0.1 rad/s.
STILL = 3e-4  # [rad/s]


def speed(result):
    """The largest speed of a joint [rad/s]."""
    return max(float(np.abs(result.trace[name]).max()) for name in JOINTS)


@pytest.mark.parametrize(("folder", "pose"), [("fmu_dir", "reach"), ("fmi3_dir", "nominal")])
def test_the_machine_stands_still_with_every_variant(system, request, folder, pose):
    """Connections reach the new FMU, also one of FMI 3.0 in a system of FMI 2.0."""
    files = sorted((request.getfixturevalue(folder) / "variants").glob("*.fmu"))
    swaps = [(c, f) for f in files for c in system.components if f.stem.startswith(f"{c}_")]
    assert len(swaps) == len(files) > 0
    for component, file in swaps:
        result = run(system, swap={component: file}, parameters=["still", pose], stop=0.3)
        assert speed(result) < STILL, file.name


def test_without_start_wires_the_machine_falls(system, fmu_dir):
    """Without the holding force the boom falls, so a machine at rest is evidence."""
    cut = system.without("boom_stick.boom_holding_force")
    options = {"swap": {"boom_stick": fmu_dir / "boom_stick.fmu"}, "parameters": ["still"], "stop": 0.3}
    assert speed(run(cut, set={"boom_stick.boom_holding_force": 0.0}, **options)) > 100 * STILL
