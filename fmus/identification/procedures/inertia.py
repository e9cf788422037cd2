"""Inertia procedure: masses and moments of inertia from joint motion and torque (the paper uses CAD values).

The momentum balance (`momentum_balance`) is linear in masses and in moments of inertia about the centres of
mass, if geometry and centres are known. All joints are fitted together. The dampings of swing and pistons are
further unknowns, so that errors of their known values do not bias the inertia. Parameters that the motion
does not determine keep their known values, and the remarks list them.

Validity: rigid links, viscous friction, correct known parameters.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from fmus.contract import quantities
from fmus.identification import balance
from fmus.identification.balance import Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.results import Curve, Estimate, Panel, ProcedureResult
from fmus.manipulator import MANIPULATOR
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

SIGNALS: Mapping[str, str] = momentum.SIGNALS
FREE = ("head_mass", "stick_inertia", "boom_inertia", "column_inertia")
DAMPINGS = ("swing_damping", "boom_piston_damping", "stick_piston_damping")
WINDOW = 0.4  # s: longer than by default, because small inertias are only visible in fast motion


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Masses and inertias `FREE` of the manipulator, from recordings of the machine, else of its joints.

    The least determined parameter is dropped until all remaining ones are determined.
    """
    procedures = [r.procedure for r in recordings if r.use == "train"]
    source = next((p for p in ("machine", "damping") if p in procedures), None)
    if source is None:
        present = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
        raise Problem(
            f'inertia: expected a recording of the machine or of a joint with use = "train", got {present}'
        )
    training, p = data.training_recordings(recordings, source, SIGNALS), momentum.parameter_vector(parameters)
    names, dropped, limits = list(FREE), list[str](), data.declared_limits(training, momentum.ALL_PRESSURES)
    while True:
        theta = tuple(f"manipulator.{n}" for n in (*names, *DAMPINGS))
        records = [momentum.joint_recording(r, momentum.JOINTS, theta, p, window=WINDOW) for r in training]
        start = {n: parameters[n].value for n in theta}
        solution = balance.solve([r.samples for r in records], start, "inertia", limits)
        fit = solution.fit
        relative = [fit.sd(n) / fit[n] if fit[n] > 0 else math.inf for n in theta[: len(names)]]
        if max(relative, default=0.0) <= balance.DETERMINED:
            break
        dropped.append(names.pop(relative.index(max(relative))))
    effects, declared = momentum.known_parameter_effects(solution, parameters), MANIPULATOR.parameters
    note, units = "balance of the joints' momenta", {n: q.unit for n, q in quantities(declared).items()}
    by_name = {n: effects[f"manipulator.{n}"] for n in names}
    seconds = sum(float(r.time[-1] - r.time[0]) for r in training)
    titles = ", ".join(r.title for r in training)
    misfit = (
        "Noise does not explain the residuals: the model is incomplete, for instance without dry "
        "friction or a swinging head. The intervals are those of the residuals."
    )
    return ProcedureResult(
        procedure="inertia",
        title="Inertial parameters from the torques of the joints",
        figure=0,
        estimates=tuple(
            Estimate.normal(n, fit[f"manipulator.{n}"], units[n], e.total, note + e.note)
            for n, e in by_name.items()
        ),
        panels=panels(records[0], solution),
        remarks=(
            f"{seconds:.3g} s of {len(training)} recordings are used: {titles}.",
            *(
                f"{n}: this motion does not determine the parameter, which keeps its known value."
                for n in dropped
            ),
            *([misfit] if fit.misfit else []),
            *(f"{n}: {text}" for n, e in by_name.items() for text in e.remarks),
        ),
        others=tuple(
            fit.estimate(f"{n}, further unknown", units[n], note, f"manipulator.{n}") for n in DAMPINGS
        ),
        findings=(
            balance.shift_finding(solution, momentum.ALL_PRESSURES, "inertia"),
            *balance.zero_findings(solution, "inertia"),
            *data.signal_findings(training, SIGNALS, "inertia"),
            balance.model_finding(solution, "inertia"),
        ),
    )


def panels(record: momentum.JointRecording, solution: Solution) -> tuple[Panel, ...]:
    """Torque and residual of each joint over the time of one recording."""
    linear = solution.parts[0].linear
    by_estimates = -np.einsum("mrt,m->rt", linear.by_theta, solution.fit.values)
    result: list[Panel] = []
    for joint, model, residual in zip(momentum.JOINTS, by_estimates, linear.e, strict=True):
        measured = Curve("measured, filtered, minus known terms", model, model + residual, line=True)
        fit = Curve("by the estimates", model, model, "fit", line=True)
        label = (f"time, {joint}", "torque")
        result += momentum.torque_panels(label, joint, record, measured, fit, "measured - model")
    return tuple(result)
