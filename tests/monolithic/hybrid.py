"""The models of hybrid.c as FMUs for Model Exchange."""

from pathlib import Path

from kit.any_fmu.description import Description, V, member, packed, tables
from kit.compile import library

SOURCE = Path(__file__).with_name("hybrid.c")
MODELS = tables(__file__)
TIME = V("time", "independent", place=0)


def build(folder: Path, model: str, version: int = 2) -> Path:
    """The FMU `model` for FMI 2.0 or 3.0."""
    variables = MODELS[model] if version == 2 else [TIME, *MODELS[model]]
    able = {"needsCompletedIntegratorStep": "true"} if version == 3 else {}
    text = Description(model, variables, {"ModelExchange": able}, initial=False).text(version)
    binary = library("hybrid", [SOURCE], f"-DFMI={version}", "-DFMI3_OVERRIDE_FUNCTION_PREFIX")
    path = folder / f"{model}{version}.fmu"
    return packed(path, {"modelDescription.xml": text, member(version, model): binary})
