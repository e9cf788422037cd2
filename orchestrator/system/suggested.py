"""What the file of a system says about the coupling of its components, and what is left of it in a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from orchestrator.settings import Coupling, chosen

INSTEAD = "to choose a way of your own, give --master and --step"


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
    place: str = ""
    only: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    aside: str = ""

    def changed(self, given: Coupling | Mapping[str, Any]) -> Suggestion:
        """With other settings: a coupling or a master among them puts aside all that was suggested."""
        if isinstance(given, Coupling):
            return Suggestion(given, aside=self.refusal or self.aside)
        coupling = chosen(given, self.coupling)
        if "master" in given:
            return Suggestion(coupling, aside=self.refusal or self.aside)
        return replace(self, coupling=coupling, given=(*self.given, *given))

    def notes(self, step_given: bool) -> tuple[str, ...]:
        """For the card of a run: what of another tool's annotation is followed, and what is not."""
        if dropped := self.aside or (self.refusal if step_given else ""):
            return (f"put aside: {dropped}",)
        if not self.source or (self.only and step_given):
            return ()
        if self.only:
            meant = " and ".join(self.only)
            return (f"the step is what {self.source} says for {meant}; all components take it",)
        given = [*dict.fromkeys(self.given), *(["step"] if step_given else [])]
        but = f", but for what was given: {', '.join(given)}" if given else ""
        return (f"coupled according to {self.source}{but}",)
