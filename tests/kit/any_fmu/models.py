"""FMUs of the models in models.h."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kit.any_fmu.description import Description, V, member, packed, tables
from kit.compile import library
from orchestrator import System, assemble

SOURCES = [Path(__file__).with_name(name) for name in ("models.c", "fmi2.c", "fmi3.c")]
WIDTHS = ("Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64")
RATES = {  # more of the masses: their input moves at it
    "mass_a": V("x2_rate", "input", "m/s", 0.0, derives="x2"),
    "mass_b": V("force_rate", "input", "N/s", 0.0, derives="force"),
}
STATES = {  # more of the masses: time derivatives of their states
    model: [
        V("der_x", "local", "m/s", depends=["v"], derives="x", place=14),
        V("der_v", "local", "m/s2", depends=[pushed, "x"], derives="v", place=15),
    ]
    for model, pushed in (("mass_a", "x2"), ("mass_b", "force"))
}
YES = "true"
ABLE: Mapping[int, Mapping[str, object]] = {
    2: {
        **dict.fromkeys(("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate"), YES),
        **{"canSerializeFMUstate": YES, "maxOutputDerivativeOrder": 1},
    },
    3: {
        **dict.fromkeys(("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState"), YES),
        **{"canSerializeFMUState": YES, "maxOutputDerivativeOrder": 1},
        "providesDirectionalDerivatives": YES,
    },
}
HIGHEST = V("highest", "parameter", None, 3, "Integer")  # and the order of input derivatives they take
LATE = V("late", "parameter", None, 0, "Integer", place=1)  # 1: slopes are NaN before the first step
RAMP = [V("ramp", "parameter", "m/s", 0.0), V("bend", "parameter", "s", 0.0)]  # of a source, from a corner on
MODELS: Mapping[str, list[V]] = {
    **tables(__file__),
    "wide": [  # FMI 3.0 only
        V("float32_in", "input", "m", 0.0, "Float32"),
        V("float32_out", "output", "m", kind="Float32", depends=["float32_in"]),
        *(
            v
            for kind in WIDTHS
            for v in (
                V(f"{kind.lower()}_in", "input", None, 0, kind),
                V(f"{kind.lower()}_out", "output", None, kind=kind, depends=[f"{kind.lower()}_in"]),
            )
        ),
        V("size", "structuralParameter", None, 3, "UInt64"),
        V("size_out", "output", None, kind="UInt64"),
    ],
}


@cache
def _library() -> bytes:
    """All models, for this machine; hidden, because the C library has a function `advance`, too."""
    header = Path(__file__).with_name("models.h")
    return library("any_fmu", SOURCES, "-std=c99", "-fvisibility=hidden", included=[header])


@dataclass
class Workshop:
    """Makes FMUs of the models in `folder`, for one version of FMI."""

    folder: Path
    fmi: int = 2
    library: bytes = field(default_factory=_library)
    _made: dict[Path, Mapping[str, bytes | str]] = field(default_factory=dict)

    def other(self, fmi: int) -> Workshop:
        """A workshop for another version of FMI, in a folder inside this one's."""
        folder = self.folder / f"fmi{fmi}"
        folder.mkdir()
        return Workshop(folder, fmi, self.library)

    def __getitem__(self, model: str) -> Path:
        """The plain FMU of a model."""
        return self.make(model)

    def make(
        self,
        model: str,
        name: str | None = None,
        units: Mapping[str, str] | None = None,
        undeclared: bool = False,
        platform: str | None = None,
        version: str | None = None,
        kind: str = "CoSimulation",
        guid: str | None = None,
        interpolates: bool = False,
        extra: Mapping[str, str] | None = None,
        more: str = "",
        experiment: str = "",
        aliases: Mapping[str, str] | None = None,
        able: Mapping[str, object] | None = None,
        changes: Mapping[str, Mapping[str, object]] | None = None,
        also: Sequence[V] = (),
    ) -> Path:
        """An FMU that differs from the plain one; it is written again only if it is another one.

        units        variable -> other unit
        undeclared   leave out all dependencies
        platform     folder of the binary; "" for none
        extra        file in the archive -> content
        more         XML of more variables
        experiment   attributes of DefaultExperiment
        aliases      variable -> its other name, in FMI 3.0
        able         attributes of the element CoSimulation that differ from those in `ABLE`
        changes      variable -> what is different about its `V`
        also         variables that the plain one does not show
        """
        name = name or model
        changed = {name: {"unit": unit} for name, unit in (units or {}).items()} | dict(changes or {})
        able = {**ABLE[self.fmi], **({"canInterpolateInputs": YES} if interpolates else {}), **(able or {})}
        description = Description(
            name,
            [replace(v, **changed.get(v.name, {})) for v in [*MODELS[model], *also]],
            {kind: able if kind == "CoSimulation" else {}},
            token=guid or model,
            version=version,
            undeclared=undeclared,
            categories=("logStatusWarning", "logStatusError"),
            experiment=experiment,
            more=more,
            aliases=aliases,
        )
        members = {"modelDescription.xml": description.text(self.fmi)}
        if platform != "":
            members[member(self.fmi, name, platform)] = self.library
        path, members = self.folder / f"{name}.fmu", members | dict(extra or {})
        if self._made.get(path) != members:
            self._made[packed(path, members)] = members
        return path


TELLS = {2: "providesDirectionalDerivative", 3: "providesDirectionalDerivatives"}
DEPENDS = {"force": ["x2", "x"], "x": ["x"], "v": ["v"]}


def telling(workshop: Workshop, model: str, name: str | None = None, **more: object) -> Path:
    """A mass that declares its states and has directional derivatives of states and outputs."""
    outputs = ("force", "x", "v") if model == "mass_a" else ("x", "v")
    given = {
        "interpolates": workshop.fmi == 2,
        "able": {TELLS[workshop.fmi]: "true"},
        "also": STATES[model],
        "changes": {y: {"depends": DEPENDS[y]} for y in outputs},
    }
    return workshop.make(model, name or f"{model}_tells", **given | more)


def oscillator_of(a: Path, b: Path) -> System:
    """Two masses and three springs."""
    return assemble({"a": a, "b": b}, ["a.force -> b.force", "b.x -> a.x2"])


def oscillation(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exact positions of its two masses at times from 0, shape (n, 2)."""
    squares, modes = np.linalg.eigh(np.array([[110.0, -100.0], [-100.0, 1100.0]]))  # N/m, masses of 1 kg
    frequencies, speeds = np.sqrt(squares), modes.T @ np.array([100.0, -100.0])
    return (np.sin(np.outer(time, frequencies)) / frequencies * speeds) @ modes.T


def bank_fmu(file: Path, changes: Mapping[str, str] | None = None) -> Path:
    """The FMU of bank.c, whose variables are arrays; changes: of its description, old -> new text."""
    return _of_source(file, "bank.c", "bank", changes or {})


def ticking_fmu(file: Path, interval: str, **changes: str) -> Path:
    """The FMU of ticks.c, whose variables belong to clocks; interval: attributes of its clock `tick`."""
    return _of_source(file, "ticks.c", "unit", {"INTERVAL": interval, **changes})


STOPS = dict.fromkeys(
    ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState", "hasEventMode"), "true"
) | {"mightReturnEarlyFromDoStep": "true"}


def stopping_fmu(
    file: Path, model: str, without: Collection[str] = (), undeclared: bool = False, **able: str
) -> Path:
    """A model of stopping.c, which stops at its events; without: variables that it does not declare.

    undeclared: it does not declare either what its outputs depend on
    """
    source = Path(__file__).with_name("stopping.c")
    variables = [v for v in tables(str(source))[model] if v.name not in without]
    text = Description(model, variables, {"CoSimulation": STOPS | able}, undeclared=undeclared).text(3)
    binary = library("stopping", [source], "-DFMI3_OVERRIDE_FUNCTION_PREFIX")
    return packed(file, {"modelDescription.xml": text, member(3, model): binary})


def _of_source(file: Path, code: str, name: str, changes: Mapping[str, str]) -> Path:
    source = Path(__file__).with_name(code)
    text = source.with_suffix(".xml").read_text("utf-8")
    for old, new in changes.items():
        text = text.replace(old, new)
    binary = library(name, [source], "-DFMI3_OVERRIDE_FUNCTION_PREFIX")
    return packed(file, {"modelDescription.xml": text, member(3, name): binary})
