"""What makes the numbers of a refinement doubtful, for the top of the page and for the terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fmus.identification.refinement.result import Refined

POOR = 0.2  # NRMSE of training: a machine whose signs, units and levers are right comes far below
CHECK = (
    "Check before you use the numbers: which lever moves which joint, the sign of each command, angle and "
    "flow, the unit of each signal, and the pose from which each recording begins."
)


def warnings(
    refined: Refined, names: Mapping[str, str] | None = None, signals: Mapping[str, str] | None = None
) -> list[str]:
    """Whole sentences, the last one with what to check; empty if nothing is doubtful.

    names, signals   parameter and output of the problem -> what the reader calls them
    """
    names, signals = names or {}, signals or {}
    found = []
    if not refined.converged:
        found.append(f"The search did not converge: {refined.reason}.")
    if refined.at_bound:
        ended = ", ".join(names.get(name, name) for name in refined.at_bound)
        found.append(f"At a bound, so not identified: {ended}.")
    poor = {name: share for name, share in _shares(refined).items() if share > POOR}
    if poor:
        told = ", ".join(
            f"{signals.get(n, n)} {_percent(poor[n])}" for n in sorted(poor, key=lambda n: -poor[n])
        )
        found.append(
            f"The model does not follow even the recordings it was fitted to; above {_percent(POOR)} of the "
            f"range (NRMSE): {told}."
        )
    return [*found, CHECK] if found else []


def _shares(refined: Refined) -> dict[str, float]:
    """NRMSE of each output over all training recordings; infinite where a simulation failed.

    Over its largest range: in a recording where a joint rests, the range of its angle is noise.
    """
    found = {}
    for k, name in enumerate(refined.problem.outputs):
        seen = [t for t in refined.training if np.any(t.run.compared[:, k])]
        if seen:
            error = np.concatenate([t.error[t.run.compared[:, k], k] for t in seen])
            size = float(np.sqrt(np.mean(error**2)) / max(t.run.scale[k] for t in seen))
            found[name] = size if np.isfinite(size) else np.inf
    return found


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "(could not be simulated)"
