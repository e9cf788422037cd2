"""Writes orchestrator/engine/arguments.py: the groups of engine/options.py as keywords of functions.

    python tools/keywords.py

A type checker wants the keywords of a function as a TypedDict, which cannot be derived from a dataclass.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

FILE = Path(__file__).parents[1] / "orchestrator" / "engine" / "arguments.py"
HEAD = '''"""Keywords of functions that simulate, as type checkers want them: engine/options.py.

Made by tools/keywords.py. A number with a unit may be a text, such as "1 ms", and several values may be one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict

from orchestrator.base.options import KEYWORDS
from orchestrator.engine import options
from orchestrator.ssp.coupling import Coupling, CouplingOptions
from orchestrator.ssp.masters import Master
'''


def text_of(hint: Any) -> str:
    """A type as it is written."""
    origin, inner = get_origin(hint), get_args(hint)
    if hint in (Any, NoneType, ...):
        return {Any: "Any", NoneType: "None", ...: "..."}[hint]
    if origin is Literal:
        return f"Literal[{', '.join(map(repr, inner))}]"
    if origin is Callable:
        return f"Callable[[{', '.join(map(text_of, inner[0]))}], {text_of(inner[1])}]"
    if origin in (Union, UnionType):
        return " | ".join(map(text_of, inner))
    return f"{hint.__name__}[{', '.join(map(text_of, inner))}]" if inner else str(hint.__name__)


def accepted(hint: Any) -> Iterator[str]:
    """The types that a keyword accepts for a field of this type."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        kind = inner[1]
        yield from (cls.__name__ for cls in kind.others)
        yield from accepted(inner[0])
        yield from ("str",) if kind.unit else ()
    elif origin in (Union, UnionType):
        for part in inner:
            yield from accepted(part)
    elif origin is tuple and inner[-1] is ...:
        if get_origin(inner[0]) is not tuple:  # one value
            yield text_of(inner[0])
        yield f"Sequence[{text_of(inner[0])}]"
    else:
        yield text_of(hint)


def keywords(group: Any) -> Iterator[str]:
    """The lines of a group; a field that is a group has its keywords among the bases."""
    hints = get_type_hints(group, include_extras=True)
    own = [name for name in vars(group).get("__annotations__", {}) if not is_dataclass(hints[name])]
    inner = [hints[name] for name in vars(group).get("__annotations__", {}) if is_dataclass(hints[name])]
    bases = [keyword_name(base.__name__) for base in (*group.__bases__, *inner) if is_dataclass(base)]
    yield f"class {keyword_name(group.__name__)}({', '.join(bases) or 'TypedDict'}, total=False):"
    yield f'    """Keywords of `{group.__name__}`."""\n'
    yield from (line(name, hints[name]) for name in own)
    yield "\n"


def line(field: str, hint: Any) -> str:
    """A keyword and its types."""
    option = get_args(hint)[1].option if get_origin(hint) is Annotated else ""
    types = [name for name in dict.fromkeys(accepted(hint)) if name != "None"]
    return f"    {option or field}: {' | '.join([*types, 'None'])}"


def keyword_name(group: str) -> str:
    """RunArguments for RunOptions."""
    return group.replace("Options", "Arguments")


def _place(group: Any, module: Any) -> str:
    return "options." if group.__module__ == module.__name__ else ""


def text() -> str:
    """The content of the file."""
    from orchestrator.engine import options

    groups = [group for name, group in vars(options).items() if name.endswith("Options")]
    lines = [line for group in groups for line in keywords(group)]
    table = [f"    {keyword_name(g.__name__)}: {_place(g, options)}{g.__name__}," for g in groups]
    source = "\n".join([HEAD, *lines, "KEYWORDS |= {", *table, "}", ""])
    command = [sys.executable, "-m", "ruff", "format", "--stdin-filename", str(FILE), "-"]
    return subprocess.run(command, input=source, capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    sys.path.insert(0, str(FILE.parents[2]))
    FILE.write_text(text(), encoding="utf-8")
