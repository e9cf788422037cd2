"""The undamped two-mass oscillator as two FMUs and an SSP, and its exact solution.

    x1'' = -10 x1 + force        force = 100 (x2 - x1)        x1 = x2 = 0, x1' = 100, x2' = -100 at the start
    x2'' = -1000 x2 - force

Mass a sends the force, with direct feed-through of x2, mass b its position. No energy is lost: what a master
makes up or loses stays in the system.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from fmus.export.compile import PLATFORMS, host, shared_library
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

SOURCE = Path(__file__).with_name("mass.c")
RECORD = ("mass_a.x", "mass_a.force", "mass_b.x")

MODEL = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name}" variableNamingConvention="flat">
<CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true"
  canInterpolateInputs="true" maxOutputDerivativeOrder="3" canGetAndSetFMUstate="true"
  providesDirectionalDerivative="true"/>
<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit><Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
<Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit></UnitDefinitions>
<DefaultExperiment startTime="0" stopTime="10" stepSize="0.001"/>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure><Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""
WIRES = ("mass_a.force -> mass_b.force", "mass_b.x -> mass_a.x2")
# name -> its variables by value reference: (name, unit, depends on the input)
MASSES = {
    "mass_a": (("x2", "m", False), ("x", "m", False), ("v", "m/s", False), ("force", "N", True)),
    "mass_b": (("force", "N", False), ("x", "m", False), ("v", "m/s", False)),
}


def build(folder: Path) -> Path:
    """Write oscillator.ssp."""
    fmus = {name: fmu(folder, name) for name in MASSES}
    system = assemble(fmus, WIRES, name="oscillator", stop=10.0, step=1e-3)
    return write_ssp(system, folder / "oscillator.ssp")


def exact(time: np.ndarray) -> np.ndarray:
    """Position of the first mass [m]: a sum of the two eigenmodes."""
    squares, modes = np.linalg.eigh(np.array([[110.0, -100.0], [-100.0, 1100.0]]))
    frequencies = np.sqrt(squares)
    amplitudes = modes.T @ np.array([100.0, -100.0]) / frequencies
    return np.sin(np.outer(time, frequencies)) @ (modes[0] * amplitudes)


def fmu(folder: Path, name: str) -> Path:
    """One mass, with its source, so that it can be compiled into other programs too."""
    sizes = f'#define MASS {list(MASSES).index(name)}\n#define MODEL_GUID "{name}"\n'.encode()
    code = {f"{name}_fmu.c": SOURCE.read_bytes(), "sizes.h": sizes}
    platform = host()
    library = shared_library(name, code, [f"{name}_fmu.c"], platform)
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", _description(name))
        for place in PLATFORMS[platform].folders:
            archive.writestr(f"binaries/{place}/{name}{PLATFORMS[platform].suffix}", library)
        for file, content in code.items():
            archive.writestr(f"sources/{file}", content)
    return path


def _description(name: str) -> str:
    (into, unit, _), *outputs = MASSES[name]
    rows = [(into, unit, 'causality="input"', ' start="0"')]
    rows += [(n, u, 'causality="output" initial="calculated"', "") for n, u, _ in outputs]
    variables = "".join(
        f'<ScalarVariable name="{n}" valueReference="{k}" variability="continuous" {role}>'
        f'<Real unit="{u}"{start}/></ScalarVariable>'
        for k, (n, u, role, start) in enumerate(rows)
    )
    unknowns = "".join(
        f'<Unknown index="{k}" dependencies="{"1" if feeds else ""}"/>'
        for k, (_, _, feeds) in enumerate(outputs, start=2)
    )
    return MODEL.format(name=name, variables=variables, unknowns=unknowns)
