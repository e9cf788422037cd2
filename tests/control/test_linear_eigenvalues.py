"""Eigenvalues of matrices with rates from 1e-6 to 1e7 1/s: against a diagonal, and against 80 digits."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest

from orchestrator import linearize
from orchestrator.linear.modes import eigen

SAME = 1e-6  # relative, what is promised of eigenvalues
DIGITS = 80  # rates reach 1e13: so many that none of what is seen here is rounding


def resolvent_trace(a, value):
    """tr (s - A)^-1 = p'(s)/p(s) with p the characteristic polynomial, by Gauss-Jordan on real blocks."""
    n, decimal = len(a), np.vectorize(Decimal, otypes=[object])
    real, imaginary = (
        decimal(-a) + Decimal(value.real) * decimal(np.eye(n)),
        Decimal(value.imag) * decimal(np.eye(n)),
    )
    m = np.block([[real, -imaginary, decimal(np.eye(n))], [imaginary, real, decimal(np.zeros((n, n)))]])
    for k in range(2 * n):
        pivot = k + int(np.argmax(np.abs(m[k:, k])))
        if not m[pivot, k]:
            return math.inf  # an exact eigenvalue, such as that of a lag by itself
        m[[k, pivot]] = m[[pivot, k]]
        m[k] = m[k] / m[k, k]
        others = np.flatnonzero((np.arange(2 * n) != k) & (m[:, k] != 0))
        m[others] = m[others] - m[others, k][:, None] * m[k]
    return complex(float(np.trace(m[:n, 2 * n :])), float(np.trace(m[n:, 2 * n :])))


@pytest.mark.parametrize(("pose", "swap"), [("folded", {}), ("reach", {"swing": "detailed"})])
def test_eigenvalues_of_the_machine_are_those_of_80_digits(fmu_dir, pose, swap):
    """|s - s_k| <= n |p(s)/p'(s)| for some eigenvalue s_k (Laguerre): each s found, to 1e-6 of itself."""
    linear = linearize(fmu_dir / "harvester.ssp", [pose], steady=True, swap=swap)
    size = np.array([s.nominal for s in linear.states])
    with localcontext() as context:
        context.prec = DIGITS
        for value in eigen(linear.a, size)[0]:
            if value and value.imag >= 0.0:  # zero is exact: the column of the swing angle is
                distance = len(size) / abs(resolvent_trace(linear.a, complex(value)))
                assert distance <= SAME * abs(value), value
    assert sum(eigen(linear.a, size)[0] == 0.0) == sum(~linear.a.any(axis=0))


def test_eigenvalues_of_mixed_scales_are_those_of_the_diagonal():
    """Rates from 1e-6 to 1e7 on the diagonal of a triangular matrix, its rows mixed, in Pa and in m3/s."""
    wanted = -np.array([9.1e6, 1e-6, 20.0, 9e6, 3e-3, 4e3, 0.5])
    rng = np.random.default_rng(0)
    triangular = wanted[:, None] * (np.eye(7) + np.triu(rng.uniform(-1, 1, (7, 7)), 1))
    place, size = rng.permutation(7), np.array([1.0, 1e7, 1e-3, 1.0, 1e7, 1e-3, 1.0])
    found = eigen((size[:, None] * triangular / size)[np.ix_(place, place)], size[place])[0]
    assert not found.imag.any()
    np.testing.assert_allclose(
        np.sort(found.real), np.sort(wanted), rtol=1e-8
    )  # hundredth of what is promised
