"""Terminals of FMUs in `assemble`: members belong together by the matching rules of FMI 3.0, 2.4.9.2."""

import pytest
from kit.mistakes import problem

from orchestrator import assemble

FILE = "terminalsAndIcons/terminalsAndIcons.xml"
# mass_a: output force and x, input x2; mass_b: input force, outputs x and v
A = {"push": "force", "at": "x2"}
B = {"push": "force", "at": "x"}
WIRES = {"a.force -> b.force", "b.x -> a.x2"}


def terminal(members, name="rod", rule="plug", kind="rod", inside=""):
    """XML of a terminal; members: name -> variable."""
    form = '<TerminalMemberVariable variableName="{}" memberName="{}" variableKind="signal"/>'
    text = "".join(form.format(variable, member) for member, variable in members.items())
    kinds = f' terminalKind="{kind}"' if kind else ""
    return f'<Terminal name="{name}" matchingRule="{rule}"{kinds}>{text}{inside}</Terminal>'


@pytest.fixture
def joined(fmus):
    """The connections of the two masses with these terminals."""

    def make(ours, theirs, *wires):
        text = "<fmiTerminalsAndIcons><Terminals>{}</Terminals></fmiTerminalsAndIcons>"
        files = {
            name: fmus.make(f"mass_{name}", f"terminal_{name}", extra={FILE: text.format(xml)})
            for name, xml in (("a", ours), ("b", theirs))
        }
        return {str(c) for c in assemble(files, wires or ["a.rod -> b.rod"]).connections}

    return make


def test_members_of_plugs_belong_together_by_name(joined):
    """In any order, from the output to the input, whichever terminal is named first."""
    turned = dict(reversed(B.items()))
    assert joined(terminal(A), terminal(turned)) == WIRES
    assert joined(terminal(A), terminal(B), "b.rod -> a.rod") == WIRES


def test_members_of_a_bus_that_only_one_has_are_left_out(joined):
    """A plug with such members does not fit."""
    assert joined(terminal(A, rule="bus"), terminal(B | {"speed": "v"}, rule="bus")) == WIRES
    told = problem(lambda: joined(terminal(A), terminal(B | {"speed": "v"})))
    assert told == "a.rod -> b.rod: expected the same members in both, got speed in one of them"


def test_members_of_a_sequence_belong_together_by_order(joined):
    """Whatever their names are."""
    other = {"f": "force", "y": "x"}
    assert joined(terminal(A, rule="sequence"), terminal(other, rule="sequence")) == WIRES


def test_terminals_inside_of_others_have_their_path(joined):
    """A terminal without kind fits one without kind."""
    inner = [terminal(m, "tip", kind="") for m in (A, B)]
    xml = [terminal({}, "rod", inside=text) for text in inner]
    assert joined(*xml, "a.rod.tip -> b.rod.tip") == WIRES


def test_a_variable_of_the_same_name_is_no_terminal(joined):
    """Both ends are terminals or both are variables; here `force` is both."""
    xml = [terminal(m, "force") for m in (A, B)]
    assert joined(*xml, "a.force -> b.force") == {"a.force -> b.force"}
    assert joined(terminal(A, "spring"), terminal(B, "plug"), "a.spring -> b.plug") == WIRES


@pytest.mark.parametrize(
    ("ours", "theirs", "wire", "message"),
    [
        (A, terminal(B, kind="shaft"), "a.rod -> b.rod", "one kind, got rod (plug) and shaft (plug)"),
        (A, terminal(B, rule="bus"), "a.rod -> b.rod", "one kind, got rod (plug) and rod (bus)"),
        (A, terminal(B), "a.rod -> b.x", "two terminals, got a.rod and b.x"),
        (A, terminal(B), "a.rod -> b.rood", "got a.rod and b.rood; did you mean b.rod, a.rod?"),
        (A | {"at": "x"}, terminal(B), "a.rod -> b.rod",
         "member at: expected an output and an input, got output a.x and output b.x"),
        (A | {"at": "y"}, terminal(B), "a.rod -> b.rod", "unknown variable 'a.y'"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_told(joined, ours, theirs, wire, message):
    """In one line that names both ends."""
    assert message in problem(lambda: joined(terminal(ours), theirs, wire))
