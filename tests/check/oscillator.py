"""The FMUs of oscillator.c: FMI 2 and FMI 3, good, or with one fault in the binary or in the text."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kit.any_fmu.description import Description, V, member, packed
from kit.compile import library

SOURCE = Path(__file__).with_name("oscillator.c")
STEP, STOP = 0.01, 2.0
FORCES = ["u", "x", "v"]
VARIABLES = [
    V("time", "independent", place=0),
    V("u", "input", start=0, place=1),
    V("stiffness", "parameter", start=40, place=2),
    V("damping", "parameter", start=0.5, place=3),
    V("x", "local", start=1, exact=True, place=4),
    V("v", "local", start=0, exact=True, place=5),
    V("der_x", "local", depends=["v"], derives="x", place=6),
    V("der_v", "local", depends=FORCES, derives="v", place=7),
    V("position", "output", depends=["x"], place=8),
    V("force", "output", depends=FORCES, place=9),
]
ABLE = {
    2: ("canGetAndSetFMUstate", "canSerializeFMUstate", "providesDirectionalDerivative"),
    3: (
        *("canGetAndSetFMUState", "canSerializeFMUState", "providesDirectionalDerivatives"),
        "providesAdjointDerivatives",
    ),
}
UPDATE = {2: (), 3: ("providesIntermediateUpdate", "canReturnEarlyAfterIntermediateUpdate")}


def description(major: int) -> str:
    """modelDescription.xml."""
    able = dict.fromkeys(ABLE[major], "true")
    slave = dict.fromkeys(("canHandleVariableCommunicationStepSize", *UPDATE[major]), "true")
    return Description(
        "oscillator",
        VARIABLES,
        {"ModelExchange": able, "CoSimulation": {**able, **slave, "maxOutputDerivativeOrder": 1}},
        initial=False,
        categories=("logEvents", "logStatusError"),
        experiment=f'startTime="0" stopTime="{STOP}" stepSize="{STEP}"',
    ).text(major)


@dataclass
class Oscillators:
    """Makes FMUs in `folder`."""

    folder: Path

    def make(
        self,
        major: int = 2,
        fault: str = "none",
        change: tuple[str, str] = ("", ""),
        extra: Mapping[str, str] | None = None,
    ) -> Path:
        """One FMU: with a fault in the binary, a changed text in modelDescription.xml, more members."""
        path = self.folder / f"oscillator_{len(list(self.folder.iterdir()))}.fmu"
        text = description(major)
        assert change[0] in text
        mark, wanted = b"FAULT=none", f"FAULT={fault}".encode()
        plain = library("oscillator", [SOURCE], "-std=gnu11", "-fno-sanitize=undefined")
        binary = plain.replace(mark + bytes(14), wanted + bytes(24 - len(wanted)))
        assert (binary == plain) == (fault == "none")
        members = {"modelDescription.xml": text.replace(*change) if change[0] else text}
        return packed(path, members | {member(major, "oscillator"): binary} | dict(extra or {}))
