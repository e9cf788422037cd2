"""The models of hybrid.c as a fixture."""

from functools import partial

import pytest

from monolithic.hybrid import build


@pytest.fixture
def fmu(once):
    """fmu("ball", 3): a model of hybrid.c, compiled once for all test processes."""

    def made(model: str, version: int):
        folder = once(f"hybrid-{model}{version}", partial(build, model=model, version=version))
        return folder / f"{model}{version}.fmu"

    return made
