"""Which experiments there are: the paper's section 4, each with its commands and instruments."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Literal, TypeAlias

from fmus.contract import ModelError
from fmus.rig import bench_plans, machine_plans
from fmus.rig.recording import Experiment

Machine: TypeAlias = Literal["lumped", "detailed"]
MACHINES: Mapping[str, str] = {
    "lumped": "lumped drives, rigid head, ideal supply: the set of the paper",
    "detailed": "detailed drives, friction with stiction, swinging head, supply of engine and pumps",
}
PLANS: Mapping[str, Callable[[str], Experiment]] = {**bench_plans.PLANS, **machine_plans.PLANS}


@cache
def experiment(name: str, machine: str) -> Experiment:
    """One experiment by the name of its files, simulated the first time it is asked for."""
    if machine not in MACHINES:
        raise ModelError(f"machine is {machine!r}, expected {' or '.join(MACHINES)}")
    return PLANS[name](machine)


def each(machine: str) -> Iterator[Experiment]:
    """The experiments, simulated one after the other."""
    return (experiment(name, machine) for name in PLANS)


def experiments(machine: str) -> list[Experiment]:
    """All experiments on a machine."""
    return list(each(machine))
