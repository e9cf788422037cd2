"""Writes a system of connected FMUs as an .ssp file: SSP 1.0, or 2.0 for FMUs of FMI 3.0."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.contract import ModelError
from fmus.export import ssb
from fmus.export.package import pack
from fmus.export.ssd import description
from fmus.export.sspxml import REAL
from fmus.export.ssv import parameter_set
from fmus.export.structure import Sets, Structure, check, read_elements


def write_ssp(
    path: Path,
    name: str,
    fmus: Mapping[str, Path],
    connections: Sequence[tuple[str, str]],
    inputs: Mapping[str, Sequence[str]] | None = None,
    start: Mapping[str, float] | None = None,
    stop: float = 10.0,
    resources: Mapping[str, bytes] | None = None,
    step: float = 1e-3,
    sets: Sets | None = None,
    bound: Sequence[str] = (),
    columns: Sequence[Sequence[str]] = (),
    version: str = "1.0",
) -> Path:
    """Write the system `name` to `path` and return it.

    fmus         component -> its .fmu file
    connections  ("swing.swing_torque", "manipulator.swing_torque"): output to input
    inputs       input of the system -> inputs of components that it feeds; starts with the value of the first
    start        "component.variable" -> start value
    stop         stop time of the default experiment [s]
    resources    name under resources/ -> content of the file
    step         communication step [s]; tools that read no vendor annotation find it in the FMUs
    sets         name of a parameter set -> its values by "component.variable"
    bound        names of the sets that hold where nobody chooses others
    columns      components of the diagram, column by column from the left
    version      of SSP: 1.0, or 2.0, whose types are those of FMI 3.0
    """
    inputs = inputs or {}
    if version not in REAL:
        raise ModelError(f"{name}: SSP version {version!r}, expected one of {', '.join(REAL)}")
    wires = [*connections, *((port, end) for port, ends in inputs.items() for end in ends)]
    elements = read_elements(fmus, wires)
    s = Structure(name, elements, wires, inputs, start or {}, sets or {}, bound, columns, stop, step, version)
    check(s)
    content = {"SystemStructure.ssd": description(s), f"resources/{ssb.FILE}": ssb.signal_dictionary(s)}
    content |= {f"resources/{c}.fmu": Path(file).read_bytes() for c, file in fmus.items()}
    content |= {f"resources/{n}.ssv": parameter_set(s, n, values) for n, values in s.sets.items()}
    content |= {f"resources/{n}": data for n, data in (resources or {}).items()}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    pack(path, content)
    return path
