"""The opening curve of a metering edge: against SciPy, and the same in C."""

import ctypes
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import VALVE
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from fmus.components import opening_curve, spool_valve
from fmus.export.c_code import native_sources
from fmus.export.c_functions import Routine, c_function
from orchestrator.base.compiler import SUFFIX, shared_library

MEASURED = ((0.8, 0.0), (1.5, 0.012), (3.0, 0.06), (5.0, 0.19), (7.5, 0.55), (10.0, 1.0))


def table(points):
    """The group of a table with these points."""
    rows = [*points, *[(0.0, 0.0)] * (opening_curve.POINTS - len(points))]
    commands = {f"command_{i}": float(v) for i, (v, _) in enumerate(rows, 1)}
    return opening_curve.OpeningTable(
        **commands, **{f"opening_{i}": float(a) for i, (_, a) in enumerate(rows, 1)}
    )


def numbers_of(edge):
    """The parameters of a measured edge."""
    return {f"valve_{edge}_{name}": value for name, value in vars(table(MEASURED)).items()}


def evaluated(points, volts):
    """Openings at commands."""
    curve = opening_curve.pieces(table(points))
    return np.array(opening_curve.CURVE.map(len(volts))(np.atleast_2d(volts), curve.coefficients)).ravel()


@st.composite
def tables(draw):
    """Points of a table that fulfils the requirements, also with steep steps and flat intervals."""
    count = draw(st.integers(2, opening_curve.POINTS))
    gaps = draw(st.lists(st.floats(2 * opening_curve.SMALLEST_GAP, 1.0), min_size=count, max_size=count))
    rises = draw(st.lists(st.sampled_from((0.0, 1e-6, 0.01, 0.3, 1.0)), min_size=count, max_size=count))
    commands, openings = np.cumsum(gaps), np.cumsum([0.0, *rises[1:]])
    return list(zip(commands, openings / max(openings[-1], 1.0), strict=True))


@given(points=tables())
def test_the_curve_is_scipys_between_the_points(points):
    """Zero up to the first point, SciPy's interpolation with a flat start, constant after the last point."""
    v, a = np.array(points).T
    volts = np.concatenate([np.linspace(-1.0, 12.0, 200), v])
    if len(points) > 2:
        inside = PchipInterpolator([v[0] - 1.0, *v], [0.0, *a])
    else:  # the end slope that stands in the equations
        inside = CubicHermiteSpline(v, a, (0.0, a[1] / (v[1] - v[0])))
    expected = np.where(volts <= v[0], 0.0, np.where(volts >= v[-1], a[-1], inside(volts)))
    # rounding of cubics over an interval of 2 mV in commands of 10 V
    np.testing.assert_allclose(evaluated(points, volts), expected, atol=1e-11)


@pytest.fixture(scope="module")
def compiled():
    """(value, slope) of the curve as the FMUs compute them, and their derivatives by all coefficients."""
    v, c = ca.SX.sym("v"), ca.SX.sym("c", opening_curve.COEFFICIENTS)
    value = opening_curve.CURVE(v, c)
    by_table = ca.densify(ca.jacobian(value, c).T)
    results = {
        "first": ca.densify(ca.vertcat(value, ca.jacobian(value, v))),
        "second": ca.densify(ca.vertcat(by_table, ca.jacobian(by_table, v))),
    }
    text = "".join(c_function(Routine(name, {"v": v, "c": c}, {"y": y}), {}) for name, y in results.items())
    assert "opening_curve(" in text
    assert "opening_curve_slope(" in text
    where = "#define where(condition, value) ((condition) ? (value) : 0.0)"  # as the function of model.h
    head = ("#include <math.h>", '#include "opening_curve.h"', "#define LOCAL", where)
    code = {
        "all.c": "\n".join([*head, text]).encode(),
        "opening_curve.h": native_sources(2)["opening_curve.h"].encode(),
    }
    flags = ["-std=c99", "-O2", "-fPIC", "-shared", "all.c", "-lm"]
    library = ctypes.CDLL(str(shared_library(f"curve{SUFFIX}", code, flags, [])))
    exact = ca.Function("f", [v, c], list(results.values()))

    def of_c(name, volts, coefficients, count):
        y = np.zeros(count)
        arrays = (np.array([volts]), np.array(coefficients, dtype=float).ravel(), y)
        getattr(library, name)(*(a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in arrays))
        return y

    return of_c, exact


@given(points=tables(), volts=st.floats(-1.0, 11.0))
def test_the_c_code_is_the_expression(compiled, points, volts):
    """The branch in C evaluates one piece, the expression all: they agree, with their derivatives."""
    of_c, exact = compiled
    coefficients = opening_curve.pieces(table(points)).coefficients
    for at in (volts, *(v for v, _ in points)):
        first, second = (np.array(y).ravel() for y in exact(at, coefficients))
        # the same sums in another order: rounding, of cubics with terms up to 1e9
        scale = max(1.0, np.abs(np.array(coefficients)).max())
        np.testing.assert_allclose(of_c("first", at, coefficients, 2), first, rtol=1e-12, atol=1e-15 * scale)
        found = of_c("second", at, coefficients, 2 * opening_curve.COEFFICIENTS)
        np.testing.assert_allclose(found, second, rtol=1e-12, atol=1e-15 * scale)


@given(dead_band=st.floats(0.0, 8.0), rounding=st.floats(1e-3, 4.0), volts=st.floats(-12.0, 12.0))
def test_without_a_table_the_curve_is_the_line(compiled, dead_band, rounding, volts):
    """In C: value and slope of the ramp with dead band, also if the rounding reaches beyond full command."""
    of_c, _ = compiled
    coefficients = opening_curve.pieces(
        table(()), opening_curve.StraightOpening(dead_band, 10.0, rounding)
    ).coefficients
    v = ca.SX.sym("v")
    line = spool_valve.opening(v, dead_band, 10.0, rounding)
    expected = ca.Function("line", [v], [ca.vertcat(line, ca.jacobian(line, v))])(volts)
    if volts == 10.0:  # a corner: the slope there is a convention
        return
    # rounding of the fourth power over 1 mV, relative to a slope of up to 1/V and more at a short line
    np.testing.assert_allclose(of_c("first", volts, coefficients, 2), np.array(expected).ravel(), atol=1e-11)


@pytest.mark.parametrize(
    ("points", "wrong"),
    [
        (MEASURED, ""),
        ((), ""),
        ([(0.0, 0.0), (5.0, 1.0)], ""),
        ([(2.0, 0.0), (1.0, 0.5)], "commands"),
        ([(1.0, 0.0), (2.0, 0.5), (2.0005, 0.6)], "commands"),
        ([(1.0, 0.0), (2.0, 0.5), (0.0, 0.0), (4.0, 1.0)], "commands"),
        ([(1.0, 0.0), (11.0, 0.5)], "commands"),
        ([(1.0, 0.0), (2.0, 0.5), (3.0, 0.4)], "openings"),
        ([(1.0, 0.1), (2.0, 0.5)], "openings"),
    ],
)
def test_points_in_disorder_are_refused(points, wrong):
    """Exactly one requirement is violated, that of the list with the mistake."""
    margins = opening_curve.requirements(replace(VALVE, pa=table(points)), 10.0)
    violated = [text for text, margin in margins.items() if not float(ca.DM(margin)) > 0]
    assert len(violated) == bool(wrong)
    assert all(text.startswith(f"valve_pa_{wrong}") for text in violated)
