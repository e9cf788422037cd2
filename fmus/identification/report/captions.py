"""What stands below a figure: what it shows, the paper's figure, and where the data come from."""

from __future__ import annotations

from collections.abc import Iterable

from fmus.identification.finding import Finding

# section 4 and 5 of the paper, in our words
PAPER = {
    5: "valve coefficient over the command",
    6: "pressure drop of a hose over the flow",
    7: "inertance and capacitance of a hose, four groups of records",
    8: "internal and external leakage of the swing motor",
    9: "damping of the swing gear and of the stick cylinder",
    10: "swing: command, angle, speed, flow, pressures",
    11: "stick: command, angle, speed, flow, pressures",
}
SIMULATED = "simulated data (virtual test rig), not FERIC data"
KINDS = {"simulation": SIMULATED, "published": "published data", "measurement": "measured data"}


def origin(kinds: Iterable[str]) -> str:
    """Where the data come from: the words for the kinds of recording, each once."""
    return "; ".join(dict.fromkeys(KINDS.get(kind, kind) for kind in kinds))


def counterpart(number: int) -> str:
    """Which figure of the paper this one corresponds to; nothing for 0."""
    return f"corresponds to Fig. {number} of the paper ({PAPER[number]})" if number in PAPER else ""


def footer(number: int, kinds: Iterable[str]) -> str:
    """The short line inside a picture: it must not travel without its origin."""
    words = [origin(kinds), f"cf. Fig. {number} of the paper" if number in PAPER else ""]
    return " · ".join(word for word in words if word)


def caption(finding: Finding, kinds: Iterable[str]) -> str:
    """One paragraph: title, origin of the data, the paper's figure."""
    return sentences(finding.title, origin(kinds), counterpart(finding.figure))


def sentences(*parts: str) -> str:
    """Parts as sentences, empty ones left out."""
    found = [part.strip().rstrip(".") for part in parts if part.strip()]
    return " ".join(f"{part[0].upper()}{part[1:]}." for part in found)
