"""The orchestrator works with any FMU: what knows the harvester is a file of the harvester."""

import ast
import io
import re
import tokenize
from pathlib import Path

import orchestrator
from fmus.contract import quantities
from fmus.controller import CONTROLLER
from fmus.machine.parts import FAMILIES
from fmus.operator_input import OPERATOR

ROOT = Path(orchestrator.__file__).parent
FILES = [path for path in sorted(ROOT.rglob("*")) if path.suffix in (".py", ".js", ".html", ".css", ".j2")]
FILES = [path for path in FILES if not path.name.endswith(".min.js")]
PARTS = [sub for family in FAMILIES.values() for sub in family.values()] + [CONTROLLER, OPERATOR]
GROUPS = [group for sub in PARTS for group in (sub.parameters, sub.states, sub.inputs, sub.outputs)]
# variables of the harvester; one word such as `engaged` or `feedback` is a word of everybody
VARIABLES = {name for group in GROUPS for name in quantities(group) if "_" in name}
WORDS = re.compile("swing|boom|slew|crane|curl|jib|grapple|yoke|manipulator|operator_input", re.IGNORECASE)
ENERGY = ('"engine_power"', 'f"{c}.stored_energy"', 'f"{c}.convected_power"')
EXEMPT = {
    ("engine/options.py", '"joint=speed, such as boom=0.1"'): "the example in a message",
    **{("results/energy.py", part): "by which any FMU tells its energy" for part in ENERGY},
}


def code(path: Path) -> list[str]:
    """What counts: lines; of Python tokens and comments, but no docstring, which may have examples."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return text.splitlines()
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    owned = [node.body[0] for node in ast.walk(ast.parse(text)) if isinstance(node, owners) and node.body]
    docs = {node.lineno for node in owned if isinstance(node, ast.Expr)}
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [t.string for t in tokens if not (t.type == tokenize.STRING and t.start[0] in docs)]


def of_command(path: str, found: set[str]) -> bool:
    """`harvester crane` and `build --crane`, and what they need, are for machines of other people."""
    return path.startswith(("cli/", "base/extras.py")) and {name.lower() for name in found} == {"crane"}


def names(text: str) -> set[str]:
    """Names of the harvester in a text."""
    return {*WORDS.findall(text), *(VARIABLES & set(re.findall(r"\w+", text)))}


def test_no_name_of_the_harvester():
    """No variable of the harvester and no word of its arm is in the code of any file."""
    named = [path for path in FILES if names(path.read_text(encoding="utf-8"))]  # in docstrings, too
    assert len(named) > 10
    parts = {(path.relative_to(ROOT).as_posix(), part) for path in named for part in code(path)}
    words = {where: names(where[1]) for where in parts - EXEMPT.keys()}
    found = {(*where, *some) for where, some in words.items() if some and not of_command(where[0], some)}
    assert found == set()


def test_exemptions_are_needed():
    """Each exemption still has its name, and the search finds what it should."""
    for file, part in EXEMPT:
        assert part in code(ROOT / file)
        assert names(part)
    assert names("x = values['supply_flow'] * boom") == {"supply_flow", "boom"}
    assert {"swing_speed", "boom_head_pressure", "payload_mass", "reference_share"} <= VARIABLES
