"""SSPs of other tools: annotations about step and master, common faults, units, and broken files."""

import re
import tomllib
from pathlib import Path

import pytest
from kit.mistakes import problem, refused, table

from orchestrator import Coupling, load, run
from orchestrator.__main__ import main
from orchestrator.ssp.coupling import CouplingOptions

SSP = "http://ssp-standard.org/SSP1/SystemStructure"
PAIR = Path(__file__).with_name("pair.ssd").read_text(encoding="utf-8")  # two coupled masses
KNOWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
FOLLOWED, REFUSED, PIECES = KNOWN["followed"], KNOWN["refused"], KNOWN["pieces"]
JACOBI = Coupling("jacobi")


def note(form: str, content: str) -> str:
    """The annotation of a tool."""
    text = KNOWN["forms"].get(form, "{}").replace("{}", content)
    for _ in range(2):  # pieces may contain others
        for name, piece in PIECES.items():
            text = text.replace(f"{{{name}}}", piece)
    return f"<ssd:Annotations>{text}</ssd:Annotations>"


def placed(*places: list[str]) -> dict[str, str]:
    """Annotations by their places in `ssd`, from place, form and content of each."""
    return {place: note(form, content) for place, form, content in places}


FIXED = note("oms", "{fixed}")
BASE = note("osp", "{base}")


def ssd(start: str = "", **places: str) -> str:
    """Two coupled masses with annotations in some places."""
    usual = dict.fromkeys(("experiment", "in_system", "in_component", "bindings", "at_end"), "")
    return PAIR.format(start=f'{start}startConnector="push"', **usual | places)


@pytest.fixture
def make(fmus, zip_ssp):
    """An .ssp with two masses."""
    parts = {"resources/a.fmu": fmus["mass_a"], "resources/b.fmu": fmus["mass_b"]}
    return lambda **places: zip_ssp(ssd(**places), parts)


# ---- step and master


@pytest.mark.parametrize("case", FOLLOWED)
def test_the_step_and_the_master_of_another_tool_are_followed(make, case):
    """As the annotation requests, with a note; without it the step would be that of the FMUs."""
    expected = {"master": "jacobi"} | FOLLOWED[case]
    places, tools, step = expected.pop("places"), expected.pop("tool").split(", "), expected.pop("step")
    system = load(make(**placed(*places)))
    coupling = Coupling(**expected)
    assert (system.coupling, system.step, system.refusal) == (coupling, step, "")
    result = run(system)
    assert result.coupling == coupling
    if coupling.adaptive is None:
        assert result.card.steps == 5  # of 0.02 s in 0.1 s
    said = " and ".join(f"the annotation of {tool} in {system.source}" for tool in tools)
    (followed,) = (n for n in result.card.notes if n.startswith("coupled"))
    assert followed == f"coupled according to {said}"


@table(__file__, "claims", "options, told")
def test_the_card_claims_no_more_than_was_followed(make, options, told):
    """The note names given options that replace the annotation; a given master replaces all of it."""
    system = load(make(in_system=FIXED))
    system = system.coupled(CouplingOptions(**options.get("coupling", {})))
    own = {name: value for name, value in options.items() if name != "coupling"}
    notes = [note for note in run(system, **own).card.notes if "annotation" in note]
    said = f"coupled according to the annotation of OMSimulator in {system.source}"
    assert notes == ([] if told == "nothing" else [said + told])


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_followed_is_refused_until_the_user_says_how(make, case):
    """One line with the reason; the system runs with a given step or master."""
    reason, *places = REFUSED[case]
    path = make(**placed(*places))
    assert re.search(rf"{reason}.*; --master and --step", problem(lambda: run(path)))
    for own in ({"step": 0.05}, {"master": "jacobi", "step": 0.05}):
        card = run(path, **own).card
        assert card.steps == 2
        assert [n for n in card.notes if n.startswith("put aside: ")] == [f"put aside: {load(path).refusal}"]


@pytest.mark.parametrize(
    "text", ["0", "-0.02", "nan", "INF", "x", "", "0,02", "0_02", "2_0e-3", "\u0660.\u0661"]
)
def test_a_step_that_is_none_is_told_and_can_be_put_aside(make, capsys, text):
    """File, line, element, expected and got; the system runs with a given step, and can be listed."""
    path = make(experiment=BASE.replace("2e-2", text))
    kind = "a positive number of seconds" if text in ("0", "-0.02") else "a finite number"
    told = rf"SystemStructure\.ssd: line \d+: FixedStepAlgorithm: expected {kind} for baseStepSize, got '{text}'; --master"
    problem(lambda: run(path), told)
    assert run(path, master="jacobi", step=0.05).card.steps == 2
    assert main(["signals", str(path)]) == 0
    assert "a.x2" in capsys.readouterr().out


@table(__file__, "steps", "step, told")
def test_a_step_that_does_not_fit_the_times_is_told_with_its_place(make, step, told):
    """The message has the line of the suggestion, unless the user gives another step."""
    path = make(in_system=FIXED.replace("0.02", step))
    place = r"ssd: line \d+ \(OMSimulator\): step: "
    problem(lambda: run(path), rf"{place}{told}, got {step} s; --master and --step over")
    problem(lambda: run(path, step=0.4), r"^step: expected at most the time from 0 to 0\.1 s, got 0\.4 s$")
    assert run(path, step=0.05).card.steps == 2


INNER = '<ssd:Component name="inner" type="application/x-ssp-{}" source="resources/inner.{}"/>'


@pytest.fixture(params=["definition", "package"])
def nest(request, fmus, zip_ssp):
    """An .ssp around another file of two masses, an .ssd or an .ssp, both with annotations."""

    def write(outer: dict[str, str], inner: dict[str, str]) -> Path:
        masses = {"a.fmu": fmus["mass_a"], "b.fmu": fmus["mass_b"]}
        part = INNER.format(request.param, "ssd" if request.param == "definition" else "ssp")
        text = ssd(**outer).replace("<ssd:Elements>", f"<ssd:Elements>{part}")
        parts = {f"resources/{name}": fmu for name, fmu in masses.items()}
        if request.param == "definition":
            return zip_ssp(text, {**parts, "resources/inner.ssd": ssd(**inner).replace("resources/", "")})
        return zip_ssp(text, {**parts, "resources/inner.ssp": zip_ssp(ssd(**inner), parts, "inner.ssp")})

    return write


def test_an_annotation_in_a_nested_file_is_followed(nest):
    """The only annotation, or one that agrees with that of the outermost file."""
    for outer in ({}, {"in_system": FIXED}, {"in_system": FIXED, "experiment": BASE}):
        system = load(nest(outer, {"in_system": FIXED}))
        assert (system.coupling, system.step, system.refusal) == (JACOBI, 0.02, "")
        (followed,) = (n for n in run(system).card.notes if n.startswith("coupled"))
        assert "inner.ss" in followed


@table(__file__, "nested", "outer, inner, told")
def test_an_annotation_in_a_nested_file_that_does_not_fit_is_refused(nest, outer, inner, told):
    """The message names the nested file."""
    path = nest(placed(*outer), placed(*inner))
    problem(lambda: run(path), told)
    assert run(path, step=0.05).card.steps == 2


def test_an_element_of_a_draft_is_told(make):
    """SSP never had `SimulationInformation`, so its step is not that of the run."""
    draft = '<ssd:SimulationInformation><ssd:FixedStepMaster stepSize="2e-2"/></ssd:SimulationInformation>'
    card = run(make(in_system=draft)).card
    assert card.step == 1e-3
    assert any(n.endswith("SimulationInformation: left out, no element of SSP") for n in card.notes)


def test_our_own_annotation_wins(make):
    """It has more choices; the annotations of other tools in harvester.ssp are for those tools."""
    ours = note("ours", 'master="gauss-seidel" step="0.05"')
    system = load(make(in_system=FIXED, experiment=ours))
    assert (system.coupling, system.step) == (Coupling("gauss-seidel"), 0.05)


# ---- slips and broken files


def test_an_empty_element_name_is_the_system(make):
    """OMSimulator writes startElement="" for a connector of the system itself."""
    plain, empty = load(make()), load(make(start='startElement="" '))
    assert plain.inputs.keys() == empty.inputs.keys() == {"push"}
    assert plain.connections == empty.connections


def test_an_empty_system_is_told(zip_ssp, capsys):
    """No FMU is run, and no success is reported."""
    text = re.sub(r"<ssd:Elements>.*</ssd:Connections>", "<ssd:Elements/>", ssd(), flags=re.S)
    told = refused(capsys, ["run", zip_ssp(text, {})])
    assert told.endswith("SystemStructure.ssd: the system has no components: expected at least one FMU\n")
