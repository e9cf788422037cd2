"""Coupling settings of a co-simulation, and the settings that the file of a system suggests.

`Coupling` holds the choice of master, extrapolation, passes and step control. `Suggestion` holds the coupling
and the step that an SSP file suggests, and which of them the user has overridden.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.options import GROUPS, Kind, Number, Seconds, Substeps, Whole, field_names
from orchestrator.ssp.masters import MASTERS, Master

MAX_PASSES = 8  # default of hermite
# Default tolerance of the passes. The work cycle at 5 ms has an error of 2.0e-5 in 1.1 passes with 1e-4, and
# of 2.4e-6 in 1.7 passes with 1e-5.
PASS_TOLERANCE = 1e-5
PASS_TOLERANCE_RATIO = 0.3  # tolerance of the passes over the tolerance of an adaptive step
# Estimated error above which an equal step is divided. On the work cycle up to 20 ms only steep changes of a
# load-sensing pressure reach it.
GUARD_TOLERANCE = 1e-2
# Where an FMU suggests a shorter step. Near the limit of stability all defects of a flow have one sign: its
# mean is off by about as much.
SHORTER_STEP_GUARD = 5e-3
SMALLEST_STEP, LARGEST_STEP = 1e-7, 0.1  # [s], defaults of adaptive runs


@dataclass(frozen=True)
class CouplingOptions:
    """How the components are coupled; relative errors are fractions of a signal's magnitude.

    master               jacobi, gauss-seidel, hermite or interface-jacobian; default: the master in the
                         system, else gauss-seidel.
    order                Order of the extrapolation of outputs over a step: 0 (held), 1, 2 or 3; default: 0
                         for jacobi and gauss-seidel, else 3.
    passes               hermite: largest number of passes over a step, at least 1; default: 8.
    coupling_tolerance   hermite: repeat a step while the end value of a signal, or its time derivative times
                         the step, changes by more than TOL times its magnitude (the nominal value, or the
                         largest value so far); default: 1e-5, with `adaptive` 0.3 of its TOL.
    factors              Number of internal steps of the component per communication step; default: 1.
    adaptive             Adapt the step so that the estimated error of each signal stays below TOL times its
                         magnitude (the nominal value, or the largest value so far), such as 1e-3; default:
                         equal steps.
    guard                Without `adaptive`: divide a step if the estimated error of a signal exceeds TOL
                         times its magnitude, or if the scenario has a corner inside the step; all components
                         must be able to restore their states; 0: never; default: 0.01 for hermite and
                         interface-jacobian; else 0.005 if an FMU suggests a shorter step than the system
                         does, or 0.
    smallest             With `adaptive`: shortest step [s], accepted with any error; default: 1e-7.
    largest              With `adaptive`: longest step [s]; default: 0.1.
    """

    master: Annotated[str | Master | None, Kind("NAME", choices=tuple(MASTERS), others=(Coupling,))] = None
    order: Whole = None
    passes: Whole = None
    tolerance: Annotated[float | None, Kind("TOL", option="coupling_tolerance")] = None
    factors: Substeps = field(default_factory=dict)
    adaptive: Number = None
    guard: Number = None
    smallest: Seconds = None
    largest: Seconds = None

    @classmethod
    def chosen(cls, options: Mapping[str, Any]) -> CouplingOptions:
        """Those of a call, by name. Raises Problem for one that is also in a `Coupling` as the master."""
        of: Any = cls  # whose hash a type checker does not know
        field_of, whole = field_names(of), options.get("master")
        own = {field_of[name]: value for name, value in options.items()}
        if not isinstance(whole, Coupling):
            return cls(**own)
        del own["master"]
        for name, value in options.items():
            other = getattr(whole, field_of[name])
            if value is not whole and other != getattr(Coupling(), field_of[name]):
                got = f"{value} and Coupling({field_of[name]}={other})"
                raise Problem(f"{name}: expected one value, got {got}")
        return replace(whole, **own)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the fields that are chosen."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) not in (None, {}))

    def added_to(self, usual: Coupling | None) -> Coupling:
        """The usual coupling with these choices; if they include a master, with no other ones."""
        own = {name: getattr(self, name) for name in self.names}
        if usual is None or self.master is not None:
            return Coupling(**own)
        return replace(usual, **{**own, "factors": {**usual.factors, **self.factors}})


GROUPS.append(CouplingOptions)


@dataclass(frozen=True)
class Coupling(CouplingOptions):
    """Coupling settings of a run, by the names of the options of `run`; `tolerance` is `coupling_tolerance`.

    A setting that would have no effect raises a Problem. master: one of `MASTERS`, by name, or a `Master`.
    """

    master: str | Master = "gauss-seidel"

    def __post_init__(self) -> None:
        if not isinstance(self.master, Master) and self.master not in MASTERS:
            raise Problem(f"unknown master {self.master!r}, expected one of {', '.join(MASTERS)}")
        if self.order not in (None, 0, 1, 2, 3):
            raise Problem(f"order of extrapolation: expected 0, 1, 2 or 3, got {self.order}")
        if self.passes is not None and self.passes < 1:
            raise Problem(f"passes: expected at least 1, got {self.passes}")
        for name, value in (("coupling tolerance", self.tolerance), ("adaptive", self.adaptive)):
            if value is not None and not value > 0:
                raise Problem(f"{name}: expected a positive number, got {value:g}")
        if self.guard is not None and not self.guard >= 0:
            raise Problem(f"guard: expected 0 or a positive number, got {self.guard:g}")
        smallest, largest = self.step_limits
        if not 0 < smallest <= largest:
            got = f"{smallest:g} s and {largest:g} s"
            raise Problem(f"smallest and largest step: expected 0 < smallest <= largest, got {got}")
        for name, factor in self.factors.items():
            if factor < 1 or factor != int(factor):
                raise Problem(f"factor of {name}: expected a whole number of steps >= 1, got {factor}")
        self._refuse_without_effect()

    def _refuse_without_effect(self) -> None:
        """Refuse settings that have no effect together with the others."""
        for name, value in (("passes", self.passes), ("coupling tolerance", self.tolerance)):
            if value is not None and not self.method.repeats:
                able = ", ".join(m.name for m in MASTERS.values() if m.repeats)
                got = f"got {self.method.name}"
                raise Problem(f"{name}: expected the master {able}, which repeats steps, {got}")
        if self.tolerance is not None and self.passes == 1:
            reason = "the tolerance ends the passes of a step"
            raise Problem(f"coupling tolerance: expected at least 2 passes, got 1: {reason}")
        if self.guard is not None and self.adaptive is not None:
            raise Problem("guard: expected equal steps, got adaptive ones, which have their own tolerance")
        for name in ("order", "factors", "adaptive", "guard") if self.method.step else ():
            if getattr(self, name):
                got = f"got {self.method.name}, which takes the steps itself"
                raise Problem(f"{name}: expected a master with a plan, {got}")
        for name in ("smallest", "largest"):
            if getattr(self, name) is not None and self.adaptive is None:
                raise Problem(f"{name}: expected adaptive steps (a tolerance `adaptive`), got equal ones")

    def check(self, components: Iterable[str]) -> None:
        """Refuse factors of unknown components."""
        names = list(components)
        for name in self.factors:
            if name not in names:
                near = suggest(name, names) or f"; there are {', '.join(names)}"
                raise Problem(f"factor of {name}: unknown component{near}")

    @property
    def method(self) -> Master:
        """The master."""
        return self.master if isinstance(self.master, Master) else MASTERS[self.master]

    @property
    def extrapolation(self) -> int:
        """Order of the extrapolation of outputs over a step."""
        return self.method.order if self.order is None else self.order

    @property
    def max_passes(self) -> int:
        """Largest number of passes over a step."""
        if not self.method.repeats:
            return 1
        return MAX_PASSES if self.passes is None else self.passes

    @property
    def pass_tolerance(self) -> float:
        """Relative error at which the passes over a step end."""
        if self.tolerance is not None:
            return self.tolerance
        return PASS_TOLERANCE if self.adaptive is None else PASS_TOLERANCE_RATIO * self.adaptive

    @property
    def guard_tolerance(self) -> float:
        """Estimated relative error above which an equal step is divided; 0: steps are not divided."""
        if self.adaptive is not None:
            return 0.0
        default = GUARD_TOLERANCE if self.method.guarded else 0.0
        return default if self.guard is None else self.guard

    @property
    def estimates_error(self) -> bool:
        """True if the run estimates the error of its steps."""
        return self.adaptive is not None or self.guard_tolerance > 0

    @property
    def step_limits(self) -> tuple[float, float]:
        """The smallest and the largest adaptive step [s]."""
        smallest = SMALLEST_STEP if self.smallest is None else self.smallest
        return smallest, LARGEST_STEP if self.largest is None else self.largest

    @property
    def text(self) -> str:
        """The master and the settings that differ from its defaults."""
        more = [] if self.order is None else [f"of order {self.order}"]
        if self.passes is not None:
            more.append("in one pass" if self.passes == 1 else f"in up to {self.passes} passes")
        each = [f"{factor} of {name}" for name, factor in self.factors.items() if factor > 1]
        more += [f"with {' and '.join(each)} in each step"] if each else []
        return " ".join([self.method.name, *more])

    @property
    def settings(self) -> dict[str, Any]:
        """All settings that have an effect, by name, defaults included."""
        settings: dict[str, Any] = {"master": self.method.name, "order": self.extrapolation}
        settings |= {"factors": dict(self.factors)} if self.factors else {}
        settings |= {"passes": self.max_passes} if self.method.repeats else {}
        settings |= {"tolerance": self.pass_tolerance} if self.max_passes > 1 else {}
        if self.adaptive is None:
            return settings | ({"guard": self.guard_tolerance} if self.guard_tolerance else {})
        smallest, largest = self.step_limits
        return settings | {"adaptive": self.adaptive, "smallest": smallest, "largest": largest}


OVERRIDE_HINT = "--master and --step override the suggestion"


@dataclass(frozen=True)
class Suggestion:
    """The coupling and the step that the file of a system suggests.

    coupling     None if the file suggests none
    step         [s]; None if the file suggests none
    refusal      why the suggestion cannot be used; empty if it can
    source       the annotation of another tool, for a note on the card of a run; empty for our annotation
    location     file and line of the suggested step, for messages
    overridden   names of settings that the user has changed
    dismissed    the refusal of a suggestion that the user has replaced by a master
    """

    coupling: Coupling | None = None
    step: float | None = None
    refusal: str = ""
    source: str = ""
    location: str = ""
    overridden: tuple[str, ...] = ()
    dismissed: str = ""

    def with_choices(self, choices: CouplingOptions) -> Suggestion:
        """The suggestion with the user's settings. A coupling or a master replaces the whole suggestion."""
        coupling = choices if isinstance(choices, Coupling) else choices.added_to(self.coupling)
        if choices.master is not None:
            return Suggestion(coupling, dismissed=self.refusal or self.dismissed)
        return replace(self, coupling=coupling, overridden=(*self.overridden, *choices.names))

    def notes(self, step_given: bool) -> tuple[str, ...]:
        """Notes for the card of a run: which parts of another tool's annotation the run follows."""
        if refusal := self.dismissed or (self.refusal if step_given else ""):
            return (f"put aside: {refusal}",)
        if not self.source:
            return ()
        overridden = [*dict.fromkeys(self.overridden), *(["step"] if step_given else [])]
        exceptions = f", except for {', '.join(overridden)}" if overridden else ""
        return (f"coupled according to {self.source}{exceptions}",)
