"""The models of hybrid.c as FMUs for Model Exchange, those of stopping.c for Co-Simulation."""

from pathlib import Path

import pytest
from kit.any_fmu.description import Description, V, member, packed, tables
from kit.any_fmu.models import stopping_fmu
from kit.compile import library

SOURCE = Path(__file__).with_name("hybrid.c")
MODELS = tables(str(SOURCE))
ROLLS = {2: "canGetAndSetFMUstate", 3: "canGetAndSetFMUState"}
TIME = V("time", "independent", place=0)


@pytest.fixture(scope="session")
def fmu(once):
    """fmu("ball", 3): a model for a version of FMI, compiled once for all test processes.

    rolls: it declares that it can save its state, as it can
    """

    def made(model: str, version: int, rolls: bool = False) -> Path:
        name = f"{model}{version}{'_rolls' * rolls}"

        def build(folder: Path) -> None:
            variables = MODELS[model] if version == 2 else [TIME, *MODELS[model]]
            able = {"needsCompletedIntegratorStep": "true"} if version == 3 else {}
            able |= {ROLLS[version]: "true"} if rolls else {}
            text = Description(model, variables, {"ModelExchange": able}, initial=False).text(version)
            binary = library("hybrid", [SOURCE], f"-DFMI={version}", "-DFMI3_OVERRIDE_FUNCTION_PREFIX")
            members = {"modelDescription.xml": text, member(version, model): binary}
            packed(folder / f"{model}{version}.fmu", members)

        return once(f"hybrid-{name}", build) / f"{model}{version}.fmu"

    return made


@pytest.fixture(scope="session")
def stopping(tmp_path_factory):
    """stopping("relay"): a model that stops at its events; without: variables that it does not declare.

    undeclared: it does not declare either what its outputs depend on
    """
    made = {}

    def make(model: str, without=(), undeclared=False, **able: str) -> Path:
        key = model, tuple(without), undeclared, tuple(sorted(able.items()))
        if key not in made:
            file = tmp_path_factory.mktemp("stopping") / f"{model}.fmu"
            made[key] = stopping_fmu(file, model, without, undeclared, **able)
        return made[key]

    return make
