"""The models of hybrid.c as FMUs for Model Exchange."""

from __future__ import annotations

from pathlib import Path

from kit.any_fmu.description import Description, V, member, packed
from kit.compile import library

SOURCE = Path(__file__).with_name("hybrid.c")
BALL = ["h", "v"]
MODELS: dict[str, list[V]] = {
    "ball": [
        V("h", "output", start=1.0, depends=BALL, exact=True, place=1),
        V("v", "output", start=0.0, depends=BALL, exact=True, place=2),
        V("der_h", "local", depends=BALL, derives="h", place=3),
        V("der_v", "local", depends=BALL, derives="v", place=4),
        V("e", "parameter", start=0.7, place=5),
        V("z", "local", depends=None, indicates=True, place=6),
    ],
    "counter": [
        V("count", "output", kind="Integer", place=1),
        V("last", "parameter", start=1000, kind="Integer", place=2),
    ],
    "thermo": [
        V("y", "input", start=0.0, place=1),
        V("low", "parameter", start=0.4, place=2),
        V("high", "parameter", start=0.6, place=3),
        V("on", "output", kind="Boolean", place=4),
        V("z", "local", depends=None, indicates=True, place=6),
    ],
    "room": [
        V("T", "output", start=0.0, depends=["T"], exact=True, place=1),
        V("der_T", "local", depends=["T"], derives="T", place=2),
        V("power", "parameter", start=1.0, place=3),
        V("on", "input", start=False, kind="Boolean", place=5),
    ],
    "gain": [
        V("u", "input", start=0.0, place=1),
        V("y", "output", depends=["u"], place=2),
        V("a", "parameter", start=0.5, place=3),
        V("b", "parameter", start=0.0, place=4),
    ],
}
TIME = V("time", "independent", place=0)


def build(folder: Path, model: str, version: int = 2) -> Path:
    """The FMU `model` for FMI 2.0 or 3.0."""
    variables = MODELS[model] if version == 2 else [TIME, *MODELS[model]]
    text = Description(model, variables, {"ModelExchange": {}}, initial=False).text(version)
    binary = library("hybrid", [SOURCE], f"-DFMI={version}", "-DFMI3_OVERRIDE_FUNCTION_PREFIX")
    path = folder / f"{model}{version}.fmu"
    return packed(path, {"modelDescription.xml": text, member(version, model): binary})
