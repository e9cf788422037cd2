"""The condensed problem agrees with the full one, solved densely with its constraints."""

import numpy as np

from fmus.identification.refinement.shooting import condense, triangular

NX, FREE, SEGMENTS, ROWS = 3, 2, 4, 40


def test_the_step_is_that_of_the_whole_system() -> None:
    """Least squares over all unknowns, with multipliers for continuity, gives the same step."""
    rng = np.random.default_rng(0)
    jacobians = rng.standard_normal((SEGMENTS, ROWS, NX + FREE))
    residuals = rng.standard_normal((SEGMENTS, ROWS))
    ends = rng.standard_normal((SEGMENTS, NX, NX + FREE))
    gaps = rng.standard_normal((SEGMENTS - 1, NX))
    prior = np.hstack([np.eye(NX), np.zeros((NX, FREE)), rng.standard_normal((NX, 1))])
    rows = [triangular(np.column_stack(both)) for both in zip(jacobians, residuals, strict=True)]
    run = condense(rows, [np.column_stack(both) for both in zip(ends[:-1], gaps, strict=True)], prior)
    dz = np.linalg.lstsq(run.bottom[:, :-1], -run.bottom[:, -1], rcond=None)[0]

    size, states = SEGMENTS * NX + FREE, SEGMENTS * NX
    rows, right = np.zeros((SEGMENTS * ROWS + NX, size)), np.append(residuals.ravel(), prior[:, -1])
    closed = np.zeros((gaps.size, size))
    for i in range(SEGMENTS):
        own, here = slice(i * NX, (i + 1) * NX), slice(i * ROWS, (i + 1) * ROWS)
        rows[here, own], rows[here, states:] = jacobians[i, :, :NX], jacobians[i, :, NX:]
        if i < SEGMENTS - 1:
            closed[own, own], closed[own, states:] = ends[i, :, :NX], ends[i, :, NX:]
            closed[own, (i + 1) * NX : (i + 2) * NX] = -np.eye(NX)
    rows[-NX:, :NX] = np.eye(NX)
    whole = np.block([[rows.T @ rows, closed.T], [closed, np.zeros((gaps.size, gaps.size))]])
    step = np.linalg.solve(whole, -np.append(rows.T @ right, gaps.ravel()))[:size]
    # rounding, through normal equations of a condition below 1e4
    np.testing.assert_allclose(dz, step[states:], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(run.states(dz).ravel(), step[:states], rtol=1e-9, atol=1e-10)
