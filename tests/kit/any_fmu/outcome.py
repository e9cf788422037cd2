"""Runs of test FMUs that C calls, and of the same FMUs called by Python, which have to leave the same."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from kit.any_fmu.models import Workshop
from orchestrator import System, assemble, run
from orchestrator.engine.result import Result, RunFailed
from orchestrator.engine.run import open_slave
from orchestrator.fmi.calls import Slave
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.system import Component

NO_ROLLBACK = {"canGetAndSetFMUstate": "false", "canGetAndSetFMUState": "false"}
HERMITE = Coupling("hermite", tolerance=1e-9)  # never content with one pass here
MASTERS = [
    *(Coupling("jacobi", 0), Coupling("jacobi", 1), Coupling("jacobi", 2)),
    *(Coupling("gauss-seidel", 0), Coupling("gauss-seidel", 1), HERMITE),
]
MAKERS = (  # methods of a slave that make a call
    *("reader", "writer", "output_derivative_reader", "input_derivative_writer"),
    "directional_derivative",
)
assert all(hasattr(Slave, name) for name in MAKERS)


class InPython:
    """An FMU that looks to the engine like any Python object: all its calls go through Python."""

    stepping = None

    def __init__(self, slave: Slave) -> None:
        self.slave = slave

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.slave, name)
        if name not in MAKERS:
            return found

        def make(*arguments: Any) -> Any:
            call = found(*arguments)
            return lambda: call()

        return make


def in_python(component: Component) -> Any:
    """Opens a component so."""
    return InPython(open_slave(component))


OPENERS = {True: open_slave, False: in_python}  # does C call the FMU?


@dataclass
class Outcome:
    """What a run left: its result, its error, and the slaves that it used."""

    result: Result
    error: str
    slaves: dict[str, Slave]

    @property
    def farewells(self) -> list[str]:
        """What the test FMUs say when they are freed: whether they had been terminated, and their states."""
        found = (m.text for slave in self.slaves.values() for m in slave.log.messages)
        return [text for text in found if "freed" in text]


def once(system: System, in_c: bool, **options) -> Outcome:
    """One run, whether it fails or not."""
    slaves = {}

    def opened(component):
        slaves[component.name] = OPENERS[in_c](component)
        return slaves[component.name]

    try:
        return Outcome(run(system, open=opened, **options), "", slaves)
    except RunFailed as failed:
        return Outcome(failed.result, str(failed), slaves)


def compare(fast: Outcome, slow: Outcome) -> None:
    """Numbers to the last bit, and words."""
    assert fast.error == slow.error
    assert fast.result.complete == slow.result.complete
    np.testing.assert_array_equal(fast.result.trace.time, slow.result.trace.time)
    for name, values in slow.result.trace.signals.items():
        np.testing.assert_array_equal(fast.result.trace[name], values, err_msg=name)
    assert fast.result.card.notes == slow.result.card.notes
    assert fast.result.card.warnings == slow.result.card.warnings
    assert fast.result.card.steps == slow.result.card.steps
    assert fast.result.messages == slow.result.messages
    assert fast.farewells == slow.farewells


CIRCLE, TURNS = ["p.y -> q.u", "q.y -> p.u"], {"q.push": 1.0, "q.gain": -1.0}


def circle(workshop: Workshop, quirk: str = "plain", able=None, changes=None, **start) -> System:
    """p' = q and q' = 1 - p, from rest at 0, so q = sin t; the component q is the one with the quirk."""
    second = workshop.fmi == 2
    curved = second and not (changes or {}).get("u_rate")
    known = {k: v for k, v in (able or {}).items() if k not in NO_ROLLBACK or ("Us" in k) == second}
    own = {"interpolates": curved, "able": known, "changes": changes}
    p = workshop.make("quirk", "quirk_p", interpolates=second)
    files = {"p": p, "q": workshop.make("quirk", f"quirk_{quirk}", **own)}
    return assemble(files, CIRCLE, TURNS | {f"q.{k}": v for k, v in start.items()})
