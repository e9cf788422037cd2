"""A, B, C, D of the harvester a second time: by FMPy, NumPy and the wires in the SSD, nothing else."""

import ctypes
import zipfile
from contextlib import ExitStack
from xml.etree import ElementTree

import numpy as np
import pytest
from kit.fmu import driving

from orchestrator import linearize

SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
COMMANDS = (
    *("swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"),
    "manipulator.payload_mass",
)
STAGES = 6  # more than there are FMUs in a row: there is no loop of direct feed-through


def opened(ssp, folder):
    """Names of the parts without the levers, and the wires between them: (source, target)."""
    with zipfile.ZipFile(ssp) as archive:
        archive.extractall(folder)
    root = ElementTree.parse(folder / "SystemStructure.ssd").getroot()
    parts = [c.get("name") for c in root.iter(f"{SSD}Component") if c.get("name") != "operator_input"]
    wires = [c.attrib for c in root.iter(f"{SSD}Connection") if c.get("startElement") in parts]
    ends = ("startElement", "startConnector"), ("endElement", "endConnector")
    return parts, [tuple((w[a], w[b]) for a, b in ends) for w in wires]


def names(fmu):
    """States, their derivatives, inputs, outputs."""
    rates = [u.variable for u in fmu.description.derivatives]
    sides = (
        [v.name for v in fmu.description.modelVariables if v.causality == c] for c in ("input", "output")
    )
    return [r.derivative.name for r in rates], [r.name for r in rates], *sides


def by_hand(ssp, folder, linear):
    """A, B, C, D at the point of a linear model, and the names of states and outputs."""
    parts, wires = opened(ssp, folder)
    point = {s.name: v for s, v in zip(linear.states, linear.x0, strict=True)}
    with ExitStack() as stack:
        fmus = {n: stack.enter_context(driving(folder / "resources" / f"{n}.fmu", "me")) for n in parts}
        own = {n: names(fmu) for n, fmu in fmus.items()}
        for n, fmu in fmus.items():
            values = [point[f"{n}.{s}"] for s in own[n][0]]
            fmu.fmu.setContinuousStates((ctypes.c_double * len(values))(*values), len(values))
        for name, value in zip(COMMANDS, linear.u0, strict=True):
            part, _, variable = name.partition(".")
            fmus[part].set(**{variable: value})
        for (a, source), (b, target) in wires * STAGES:
            fmus[b].set(**{target: fmus[a].get(source)[0]})
        x, v, y = ([f"{n}.{s}" for n in parts for s in own[n][k]] for k in (0, 2, 3))
        every = np.zeros((len(x) + len(y), len(x) + len(v)))
        for n, (states, rates, inputs, outputs) in own.items():
            of_x = [x.index(f"{n}.{s}") for s in states]
            rows = of_x + [len(x) + y.index(f"{n}.{s}") for s in outputs]
            columns = of_x + [len(x) + v.index(f"{n}.{s}") for s in inputs]
            every[np.ix_(rows, columns)] = fmus[n].derivative([*rates, *outputs], [*states, *inputs])
    (a, b), (c, d) = (np.hsplit(half, [len(x)]) for half in np.vsplit(every, [len(x)]))
    wired = np.zeros((len(v), len(y)))
    for source, target in wires:
        wired[v.index(".".join(target)), y.index(".".join(source))] = 1.0
    fed = np.array([[float(name == command) for command in COMMANDS] for name in v])
    closed = np.linalg.inv(np.eye(len(v)) - wired @ d)
    of_x, of_u = closed @ wired @ c, closed @ fed
    return (a + b @ of_x, b @ of_u, c + d @ of_x, d @ of_u), x, y


@pytest.mark.parametrize("speeds", [{}, {"swing": 0.2, "boom": 0.1, "stick": -0.2}])
def test_the_matrices_are_those_made_by_hand(fmu_dir, tmp_path, speeds):
    """At rest and with every valve open, each entry of A, B, C and D."""
    linear = linearize(fmu_dir / "harvester.ssp", parameters=["folded"], steady=True, speeds=speeds)
    moves = "".join(f"; manipulator.{joint}_angle moves at {v:g} rad per s" for joint, v in speeds.items())
    assert linear.text().splitlines()[2] == f"steady state{moves}"
    (a, b, c, d), x, y = by_hand(fmu_dir / "harvester.ssp", tmp_path, linear)
    i, j = [x.index(s.name) for s in linear.states], [y.index(s.name) for s in linear.outputs]
    assert len(i) == len(x)
    assert (np.abs(b).max(axis=0) > 0.0).all() == bool(speeds)  # at rest the swing is in its dead band
    by = (a[i][:, i], b[i], c[j][:, i], d[j])
    for found, wanted in zip((linear.a, linear.b, linear.c, linear.d), by, strict=True):
        # sums in another order: rounding; below 1e-30 are products of openings that underflow
        np.testing.assert_allclose(found, wanted, rtol=1e-14, atol=1e-30)
