"""How a system is coupled: master, extrapolation, passes, steps; and what the file of a system suggests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from orchestrator.base.errors import Problem, suggest

MASTERS = ("jacobi", "gauss-seidel", "hermite", "interface-jacobian")
# of extrapolation, where the user says nothing
DEFAULT_ORDERS = {"jacobi": 0, "gauss-seidel": 0, "hermite": 3, "interface-jacobian": 3}
CONTROLS = ("error", "energy")

# Where the user says nothing: of hermite, and of adaptive runs.
MAX_PASSES = 8
# Tolerance of the passes. Work cycle at 5 ms: 1e-4 gives 2.0e-5 in 1.1 passes, 1e-5 gives 2.4e-6 in 1.7
PASS_TOLERANCE = 1e-5
# Estimated error at which a step of equal ones is divided: no step of the work cycle up to 20 ms comes to it
GUARD_TOLERANCE = 1e-2
GUARDED_MASTERS = ("hermite", "interface-jacobian")
PASS_TOLERANCE_RATIO = 0.3  # of the tolerance of an adaptive step: tolerance of its passes
SMALLEST_STEP, LARGEST_STEP = 1e-7, 0.1  # [s]


@dataclass(frozen=True)
class Coupling:
    """All choices about the coupling of a run; a choice that would have no effect is a Problem.

    master      one of MASTERS
    order       at which sources are continued over a step: 0, 1, 2 or 3; default: that of ORDERS
    passes      hermite: how often a step is computed at most; default: 8
    tolerance   hermite: a step is computed again while value or slope (times the step) of a signal ends
                further from its source, as a share of its magnitude: the nominal value, or the largest seen;
                default: 1e-5, of adaptive runs 0.3 of their tolerance
    correct     inputs get back what their continuation lost over the step before
    lag         interface-jacobian: steps for which a linearisation is kept
    factors     component -> how many steps of its own it takes in one communication step
    adaptive    None: all steps are as long as the user says; else the tolerance of their estimated error, as
                a share of the magnitude of each signal
    control     what that tolerance is of: "error" of the signals (default), or "energy" of the power bonds
    guard       of runs with equal steps: one whose estimated error is larger, as a share of the magnitude of
                a signal, is divided, and so is one with a corner of a scenario inside, where all components
                can go back; 0: never; default: 0.01 for hermite and interface-jacobian, else 0
    smallest    step [s] of adaptive runs; at it errors above the tolerance are let pass; default: 1e-7
    largest     step [s] of adaptive runs; default: 0.1
    """

    master: str = "gauss-seidel"
    order: int | None = None
    passes: int | None = None
    tolerance: float | None = None
    correct: bool = False
    lag: int = 1
    factors: Mapping[str, int] = field(default_factory=dict)
    adaptive: float | None = None
    control: str | None = None
    guard: float | None = None
    smallest: float | None = None
    largest: float | None = None

    def __post_init__(self) -> None:
        if self.master not in MASTERS:
            raise Problem(f"unknown master {self.master!r}, expected one of {', '.join(MASTERS)}")
        if self.order not in (None, 0, 1, 2, 3):
            raise Problem(f"order of extrapolation: expected 0, 1, 2 or 3, got {self.order}")
        if self.passes is not None and self.passes < 1:
            raise Problem(f"passes: expected at least 1, got {self.passes}")
        if self.lag < 1:
            raise Problem(f"lag: expected at least 1 step, got {self.lag}")
        for name, value in (("coupling tolerance", self.tolerance), ("adaptive", self.adaptive)):
            if value is not None and not value > 0:
                raise Problem(f"{name}: expected a positive number, got {value:g}")
        if self.guard is not None and not self.guard >= 0:
            raise Problem(f"guard: expected 0 or a positive number, got {self.guard:g}")
        if self.control not in (None, *CONTROLS):
            raise Problem(f"unknown control {self.control!r}, expected one of {', '.join(CONTROLS)}")
        smallest, largest = self.step_limits
        if not 0 < smallest <= largest:
            got = f"{smallest:g} s and {largest:g} s"
            raise Problem(f"smallest and largest step: expected 0 < smallest <= largest, got {got}")
        for name, factor in self.factors.items():
            if factor < 1 or factor != int(factor):
                raise Problem(f"factor of {name}: expected a whole number of steps from 1 on, got {factor}")
        self._refuse_without_effect()

    def _refuse_without_effect(self) -> None:
        """Refuse what the other choices leave without effect."""
        for name, value in (("passes", self.passes), ("coupling tolerance", self.tolerance)):
            if value is not None and self.master != "hermite":
                raise Problem(f"{name}: only hermite computes a step again, the master is {self.master}")
        if self.lag != 1 and self.master != "interface-jacobian":
            raise Problem(f"lag: only interface-jacobian keeps linearisations, the master is {self.master}")
        if self.tolerance is not None and self.passes == 1:
            raise Problem("coupling tolerance: it ends the passes of a step, expected more of them than 1")
        if self.correct and self.master == "interface-jacobian":
            raise Problem(f"correct: {self.master} predicts the inputs, expected another master")
        if self.correct and self.master == "hermite" and self.passes != 1:
            many = f"up to {self.max_passes} passes"
            raise Problem(f"correct: expected a single pass, with which hermite loses something, got {many}")
        if self.guard is not None and self.adaptive is not None:
            raise Problem("guard: adaptive steps have a tolerance already, expected one of the two")
        for name in ("control", "smallest", "largest"):
            if getattr(self, name) is not None and self.adaptive is None:
                raise Problem(f"{name}: of adaptive steps only, expected a tolerance for them (adaptive)")

    def check(self, components: Iterable[str]) -> None:
        """Refuse factors of what is no component."""
        known = list(components)
        for name in self.factors:
            if name not in known:
                near = suggest(name, known) or f"; there are {', '.join(known)}"
                raise Problem(f"factor of {name}: no component of that name{near}")

    @property
    def extrapolation(self) -> int:
        """The order of extrapolation."""
        return DEFAULT_ORDERS[self.master] if self.order is None else self.order

    @property
    def max_passes(self) -> int:
        """How many passes a step takes at most."""
        if self.master != "hermite":
            return 1
        return MAX_PASSES if self.passes is None else self.passes

    @property
    def pass_tolerance(self) -> float:
        """The tolerance of the passes."""
        if self.tolerance is not None:
            return self.tolerance
        return PASS_TOLERANCE if self.adaptive is None else PASS_TOLERANCE_RATIO * self.adaptive

    @property
    def guard_tolerance(self) -> float:
        """The estimated error at which a step of equal ones is divided; 0: none is."""
        if self.adaptive is not None:
            return 0.0
        usual = GUARD_TOLERANCE if self.master in GUARDED_MASTERS else 0.0
        return usual if self.guard is None else self.guard

    @property
    def estimates_error(self) -> bool:
        """Is the error of steps estimated?"""
        return self.adaptive is not None or self.guard_tolerance > 0

    @property
    def step_limits(self) -> tuple[float, float]:
        """The smallest and the largest adaptive step [s]."""
        smallest = SMALLEST_STEP if self.smallest is None else self.smallest
        return smallest, LARGEST_STEP if self.largest is None else self.largest

    @property
    def controls_energy(self) -> bool:
        """Is the tolerance of adaptive steps one of energy?"""
        return self.control == "energy"

    @property
    def text(self) -> str:
        """The master, with what differs from its usual settings."""
        more = [] if self.order is None else [f"of order {self.order}"]
        if self.passes is not None:
            more.append("in one pass" if self.passes == 1 else f"in up to {self.passes} passes")
        more += ["with correction"] if self.correct else []
        more += ["with control of the energy"] if self.controls_energy else []
        more += [f"linearised every {self.lag} steps"] if self.lag > 1 else []
        each = [f"{factor} of {name}" for name, factor in self.factors.items() if factor > 1]
        more += [f"with {' and '.join(each)} in each step"] if each else []
        return " ".join([self.master, *more])

    @property
    def settings(self) -> dict[str, Any]:
        """All that has an effect, by name, also what nobody chose."""
        found: dict[str, Any] = {"master": self.master, "order": self.extrapolation, "correct": self.correct}
        found |= {"factors": dict(self.factors)} if self.factors else {}
        found |= {"lag": self.lag} if self.master == "interface-jacobian" else {}
        found |= {"passes": self.max_passes} if self.master == "hermite" else {}
        found |= {"tolerance": self.pass_tolerance} if self.max_passes > 1 else {}
        if self.adaptive is None:
            return found | ({"guard": self.guard_tolerance} if self.guard_tolerance else {})
        smallest, largest = self.step_limits
        how = {"adaptive": self.adaptive, "control": self.control or CONTROLS[0]}
        return found | how | {"smallest": smallest, "largest": largest}


def merge_choices(given: Mapping[str, Any], usual: Coupling | None = None) -> Coupling:
    """The choices `given` by name; a given master stands for itself, else the others are those of `usual`."""
    if usual is None or "master" in given:
        return Coupling(**given)
    factors = {**usual.factors, **given.get("factors", {})}
    return replace(usual, **{**given, "factors": factors})


OVERRIDE_HINT = "to choose a way of your own, give --master and --step"


@dataclass(frozen=True)
class Suggestion:
    """How to couple.

    coupling, step   None where nothing is said; step [s]
    refusal          why what is said cannot be followed; empty where it can
    source           what says it, for a note on the card of a run; empty for an annotation of ours
    place            where the step is said, for the message about one that does not fit
    only             the components that the step is meant for, where it is said for some only
    given            settings that were changed afterwards
    aside            the refusal that a given master has put aside
    """

    coupling: Coupling | None = None
    step: float | None = None
    refusal: str = ""
    source: str = ""
    location: str = ""
    components: tuple[str, ...] = ()
    overridden: tuple[str, ...] = ()
    dismissed: str = ""

    def with_choices(self, given: Coupling | Mapping[str, Any]) -> Suggestion:
        """With other settings: a coupling or a master among them puts aside all that was suggested."""
        if isinstance(given, Coupling):
            return Suggestion(given, dismissed=self.refusal or self.dismissed)
        coupling = merge_choices(given, self.coupling)
        if "master" in given:
            return Suggestion(coupling, dismissed=self.refusal or self.dismissed)
        return replace(self, coupling=coupling, overridden=(*self.overridden, *given))

    def notes(self, step_given: bool) -> tuple[str, ...]:
        """For the card of a run: what of another tool's annotation is followed, and what is not."""
        if dropped := self.dismissed or (self.refusal if step_given else ""):
            return (f"put aside: {dropped}",)
        if not self.source or (self.components and step_given):
            return ()
        if self.components:
            meant = " and ".join(self.components)
            return (f"the step is what {self.source} says for {meant}; all components take it",)
        given = [*dict.fromkeys(self.overridden), *(["step"] if step_given else [])]
        but = f", but for what was given: {', '.join(given)}" if given else ""
        return (f"coupled according to {self.source}{but}",)
