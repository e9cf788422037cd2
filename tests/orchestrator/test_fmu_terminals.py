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


def both(a, b, *more, **options):
    """Terminals with these members on either side."""
    return terminal(a, *more, **options), terminal(b, *more, **options)


@pytest.mark.parametrize(
    ("terminals", "wires"),
    [
        # plugs: by name, in any order, from the output to the input, whichever terminal is named first
        (both(A, dict(reversed(B.items()))), ()),
        (both(A, B), ("b.rod -> a.rod",)),
        # a bus: members that only one has are left out; a sequence: by order, whatever the names are
        (both(A, B | {"speed": "v"}, rule="bus"), ()),
        (both(A, {"f": "force", "y": "x"}, rule="sequence"), ()),
        # inside of another one, by the path; a terminal without kind fits one without kind
        ([terminal({}, inside=text) for text in both(A, B, "tip", kind="")], ("a.rod.tip -> b.rod.tip",)),
        ((terminal(A, "spring"), terminal(B, "plug")), ("a.spring -> b.plug",)),
    ],
)
def test_members_belong_together(joined, terminals, wires):
    """Each input is connected to the output that its matching rule says."""
    assert joined(*terminals, *wires) == WIRES


def test_a_variable_of_the_same_name_is_no_terminal(joined):
    """Both ends are terminals or both are variables; here `force` is both."""
    assert joined(*both(A, B, "force"), "a.force -> b.force") == {"a.force -> b.force"}


@pytest.mark.parametrize(
    ("ours", "theirs", "wire", "message"),
    [
        (A, terminal(B | {"speed": "v"}), "a.rod -> b.rod", "the same members in both, got speed in one of"),
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
