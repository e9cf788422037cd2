"""What is run: tools, their options, and the communication steps in each case. Extend the tables here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from orchestrator import Coupling

USUAL = 1e-3  # s; here the cost of a step is compared, with and without recording

# case -> steps [s]; the times that errors are taken at are multiples of each
PLAIN = {
    "wired": (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 8e-3, 1e-2),
    "cut": (1e-4, 2e-4, 5e-4, 1e-3),
    "m1": (2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2),
    "oscillator": (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2),
    "motor": (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2),
    "truck": (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3),
}
# for tools that take a fraction of a millisecond for a step
SLOW = PLAIN | {"wired": (5e-4, 1e-3, 2e-3, 5e-3, 8e-3), "cut": (2e-4, 5e-4, 1e-3, 2e-3)}
# where slopes are exchanged and steps repeated
LARGE = {case: (1e-3, 2e-3, 5e-3, 1e-2, 2e-2) for case in PLAIN} | {
    "truck": (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3)
}
LARGEST = {case: (5e-3, 1e-2, 2e-2, 4e-2) for case in ("wired", "cut")}
ONE_PASS = LARGE | {case: (1e-3, 2e-3, 5e-3, 8e-3, 1e-2, 4e-2 / 3) for case in ("wired", "cut")}
ACCURACIES = {case: (1e-6, 1e-5, 1e-4, 1e-3, 1e-2) for case in PLAIN}
ONCE = {case: (USUAL,) for case in PLAIN}


@dataclass(frozen=True)
class Setting:
    """One tool with one set of options.

    tool      a module of `tools`
    values    case -> values of the option `vary`; a case that is not there is left out
    options   of the tool's `run`; for ours those of `orchestrator.run`
    vary      the option that goes through the values, from the finest to the coarsest
    drawn     label in the figure; empty: not drawn
    """

    label: str
    tool: str
    values: Mapping[str, tuple[float, ...]]
    options: Mapping[str, Any] = field(default_factory=dict)
    vary: str = "step"
    drawn: str = ""

    @property
    def ours(self) -> bool:
        """Not a peer."""
        return self.tool == "ours"


PEERS = (
    Setting("FMPy", "fmpy_ssp", SLOW, drawn="FMPy"),
    Setting("PyFMI", "pyfmi_master", SLOW, drawn="PyFMI"),
    Setting("PyFMI of order 1", "pyfmi_master", SLOW, {"order": 1}, drawn="PyFMI, order 1"),
    Setting("OMSimulator", "omsimulator", SLOW, drawn="OMSimulator"),
    Setting("Ecos", "ecos", PLAIN, drawn="Ecos"),
    Setting("Ecos, one thread", "ecos", ONCE, {"threads": 1}),
    Setting("libcosim, no worker", "libcosim", PLAIN, {"workers": 0}, drawn="libcosim"),
    Setting("libcosim, 1 worker", "libcosim", ONCE, {"workers": 1}),
)
ORDER_3 = Coupling("gauss-seidel", 3)
TWO_PASSES = Coupling("hermite", passes=2)
OURS = (
    Setting("jacobi", "ours", PLAIN, {"master": "jacobi"}, drawn="jacobi"),
    Setting("gauss-seidel", "ours", PLAIN, {"master": "gauss-seidel"}, drawn="gauss-seidel"),
    Setting("gauss-seidel order 3", "ours", ONE_PASS, {"master": ORDER_3}, drawn="gauss-seidel order 3"),
    Setting("order 3, FMUs at 1e-3", "ours", ONE_PASS, {"master": ORDER_3, "tolerance": 1e-3}),
    Setting("hermite", "ours", LARGE, {"master": "hermite"}, drawn="hermite"),
    Setting("hermite, 2 passes", "ours", LARGE, {"master": TWO_PASSES}),
    Setting("2 passes, FMUs at 1e-3", "ours", LARGE, {"master": TWO_PASSES, "tolerance": 1e-3}),
    Setting(
        "interface-jacobian", "ours", LARGE, {"master": "interface-jacobian"}, drawn="interface-jacobian"
    ),
)
CHOSEN = Setting("--accuracy", "ours", ACCURACIES, vary="accuracy", drawn="--accuracy")
SETTINGS = (*PEERS, *OURS, CHOSEN)
