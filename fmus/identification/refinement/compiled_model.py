"""A subsystem compiled to C for output-error identification: the equations and the solver of its FMU, with
exact forward sensitivities of the solver's steps, derived symbolically, of a reduced model.

A step of the solver is (export/native/rosenbrock.c)

    M k_i = f(X_i) + sum_j c_ij / h k_j + g_i h f_u du,    M = I / (gamma h) - J(x),  X_i = x + sum_j a_ij k_j

The sensitivity with respect to an initial state or a parameter q, at fixed step size h, follows from

    M dk_i = J(X_i) dX_i + f_q(X_i) dq + sum_j c_ij / h dk_j + D,
    D = directional derivative of [J(x) k_i + g_i h f_u(x) du] along (dx, dq)

The solver has factorised M for the step itself; the LU factors are reused for all sensitivity columns.
D needs second derivatives of f. They are constant over the step (evaluated at x) and are contracted with
(k_i, g_i h du) in each stage.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import casadi as ca
import numpy as np

from fmus.called_functions import without_zero_calls
from fmus.contract import Quantity, Subsystem, Symbolic, column, quantities, symbolic
from fmus.export.c_code import generated, generator_sources, native_sources
from fmus.export.c_functions import Routine, c_function, hoist
from fmus.export.elimination import Elimination, Entry, eliminate, nonzeros
from fmus.export.interface import Interface, Kind, Variable, make_interface
from fmus.parameters import Values
from fmus.parameters import values as default_values
from orchestrator.base.compiler import SUFFIX, kept, shared_library
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

DELAY_STEP = 1e-3  # s, of the difference quotients by a delay; a fifth of the period of a usual logger
WIDTH = 8  # sensitivity columns per vector: a cache line, one to four registers of current processors
COMPILER_FLAGS = (
    "-std=gnu11",
    "-O2",
    "-g0",
    "-fPIC",
    "-shared",
    "-fvisibility=hidden",
    # the model must give the floating-point results of the FMU; sens.h allows contraction after it
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-mcpu=native",  # widest vector registers; the build cache is keyed by processor
)
C_FILES = ("model.c", "inputs.c", "rosenbrock.c", "runge_kutta.c", "solver.c", "sens.c", "sensitivities.c")
Entries = Mapping[Entry, ca.SX]  # structural nonzeros of a matrix
_POINTER = ctypes.POINTER(ctypes.c_double)
_REQUIREMENT = 5
_MESSAGES = (  # by the status of native/solver.h and native/sensitivities.c
    "",
    "the derivative of {} is not finite",
    "the Jacobian is singular",
    "steps become too small, the error is largest in {}",
    "too many steps between two samples",
    'requirement "{}" is violated',
    "an output or its sensitivity is not finite",
)


class SimulationFailed(Exception):
    """A simulation that ended early: the reason, and the time [s] that it reached."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(f"{reason} at t = {time:.9g} s")
        self.time = time


@dataclass(frozen=True)
class SegmentSolution:
    """A segment of n samples; the sensitivities are empty arrays if none were requested.

    y          outputs at the samples, shape (n, ny)
    x          states at the last sample, shape (nx,)
    y_x, y_p   sensitivities of y to the initial states and to the parameters, (n, ny, nx), (n, ny, np)
    x_x, x_p   sensitivities of x to the same, (nx, nx), (nx, np)
    steps      number of solver steps, 0 if unknown
    """

    y: Array
    x: Array
    y_x: Array
    y_p: Array
    x_x: Array
    x_p: Array
    steps: int = 0


def zero_of(output: str) -> str:
    """Name of the free parameter that is the zero of an output's sensor."""
    return "zero_of_" + output


def delay_of(input_name: str) -> str:
    """Name of the free parameter by which an input acts later than its time stamps [s]."""
    return "delay_of_" + input_name


class CompiledModel:
    """A simulator in C with exact sensitivities of the solver's steps.

    states, inputs   names of those that the outputs depend on: the others are left out
    free             parameters of the subsystem, then zeros of sensors: a reading is an output plus its zero,
                     then delays of inputs, see `delayed_inputs`
    nominal          nominal values of the states, shape (nx,)
    p0               initial values of the free parameters, shape (np,)
    """

    def __init__(
        self,
        sub: Subsystem,
        outputs: Sequence[str],
        free: Sequence[str],
        values: Values | None = None,
        tolerance: float = 1e-6,
    ) -> None:
        values = values or default_values(sub)
        zeros = [name for name in outputs if zero_of(name) in free]
        delays = [name for name in quantities(sub.inputs) if delay_of(name) in free]
        model = reduce_model(sub, outputs, free[: len(free) - len(zeros) - len(delays)])
        self.states, self.inputs, self.outputs = model.states, model.inputs, model.outputs
        self.free = (*model.estimated, *map(zero_of, zeros), *map(delay_of, delays))
        self.nominal: Array = np.array([model.quantities[name].nominal for name in model.states])
        self._zeros = [self.outputs.index(name) for name in zeros]
        self._p = np.array([values.p[name] for name in model.parameters])
        self._indices = np.array([model.parameters.index(n) for n in model.estimated], dtype=np.intp)
        self.p0 = np.append(self._p[self._indices], np.zeros(len(zeros) + len(delays)))
        self._dynamic = np.array(model.dynamic, dtype=np.intp)
        self._statements = model.equations.statements
        self._tolerance = tolerance
        self._all_x = np.array(list(values.x.values()))
        eqs, by_others = model.equations, ca.SX(len(self.states), len(zeros) + len(delays))
        start_p = ca.densify(ca.horzcat(ca.jacobian(model.start, model.q), by_others))
        self._start = ca.Function("start", [model.all_x, eqs.u, eqs.p], [model.start, start_p])
        self._simulate = library(kept_sources(model)).simulate
        self._simulate.restype = ctypes.c_int
        arrays = [_POINTER] * 4
        self._simulate.argtypes = [ctypes.c_int, *arrays, ctypes.c_double, ctypes.c_int, *arrays]

    def start(self, p: Array, u0: Array) -> tuple[Array, Array]:
        """Initial states by the subsystem's `initial`, (nx,), and their derivatives by p, (nx, np)."""
        x, x_p = self._start(self._all_x, u0, self._all_parameters(p))
        return x.full()[:, 0], x_p.full()

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> SegmentSolution:
        """The trajectory from the states x at time[0] to time[-1].

        time    of the samples [s], increasing, shape (n,)
        inputs  at the samples, linear between them, shape (n, nu), or several of them from `delayed_inputs`

        Raises SimulationFailed. Thread-safe; the C code runs without Python's global lock.
        """
        if inputs.ndim == 3:
            return self._by_delays(x, p, time, inputs, sensitivities)
        time, inputs = (np.ascontiguousarray(a, dtype=np.float64) for a in (time, inputs))
        n, nx, ny = time.size, len(self.states), len(self.outputs)
        self._check(x, p, time, inputs)
        columns = -(-(self._dynamic.size + nx) // WIDTH) * WIDTH if sensitivities else 0
        x, y, report = np.array(x, dtype=np.float64), np.empty((n, ny)), np.zeros(3)
        dy, dx = np.empty((n, ny, columns)), np.empty((nx, columns))
        arguments = [a.ctypes.data_as(_POINTER) for a in (time, inputs, x, self._all_parameters(p))]
        results = [a.ctypes.data_as(_POINTER) for a in (y, dy, dx, report)]
        status = self._simulate(n, *arguments, self._tolerance, int(sensitivities), *results)
        if status:
            names = self._statements if status == _REQUIREMENT else self.states
            raise SimulationFailed(_MESSAGES[status].format(names[int(report[2])]), report[0])
        y_x, y_p = self._split(dy)
        first, last = self._indices.size, self._indices.size + len(self._zeros)
        y[:, self._zeros] += p[first:last]
        if sensitivities:
            y_p[:, self._zeros, range(first, last)] = 1.0
        return SegmentSolution(y, x, y_x, y_p, *self._split(dx), int(report[1]))

    def _by_delays(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool
    ) -> SegmentSolution:
        """The segment with the first inputs; the others are those with one delay `DELAY_STEP` longer."""
        found = self.segment(x, p, time, inputs[0], sensitivities)
        for j, later in enumerate(inputs[1:], len(p) - len(inputs) + 1) if sensitivities else ():
            other = self.segment(x, p, time, later, False)
            found.y_p[..., j] = (other.y - found.y) / DELAY_STEP
            found.x_p[:, j] = (other.x - found.x) / DELAY_STEP
        return found

    def _check(self, x: Array, p: Array, time: Array, inputs: Array) -> None:
        """Check the shapes, beyond which C would read."""
        for argument, array, expected, names in (
            ("inputs", inputs, (time.size, len(self.inputs)), self.inputs),
            ("states", x, (len(self.states),), self.states),
            ("parameters", p, (len(self.free),), self.free),
        ):
            if np.shape(array) != expected:
                listed = f" ({', '.join(names)})" if names else ""
                raise Problem(f"{argument}: expected shape {expected}{listed}, got {np.shape(array)}")
        if time.ndim != 1 or time.size == 0 or not (np.diff(time) > 0).all():
            raise Problem("times of the samples: expected one or more, each later than the one before")

    def _all_parameters(self, p: Array) -> Array:
        """Values of all parameters of the subsystem, in the order of their declaration."""
        values = self._p.copy()
        values[self._indices] = p[: self._indices.size]
        return values

    def _split(self, columns: Array) -> tuple[Array, Array]:
        """Derivatives by the states and by all free parameters; zero for those that are not dynamic."""
        dynamic, nx = self._dynamic.size, len(self.states)
        if columns.shape[-1] == 0:
            return columns, columns
        by_p = np.zeros((*columns.shape[:-1], len(self.free)))
        by_p[..., self._dynamic] = columns[..., :dynamic]
        return columns[..., dynamic : dynamic + nx], by_p


def delayed_inputs(simulator: CompiledModel, p: Array, time: Array, inputs: Array) -> Array:
    """The inputs of a whole run, shape (n, nu), later by their delays; the same array if none is estimated.

    With delays the shape is (1 + number of delays, n, nu): one after the other is longer by `DELAY_STEP`.
    """
    delays = [j for j, name in enumerate(simulator.free) if name.startswith(delay_of(""))]
    if not delays:
        return inputs
    result = np.repeat(inputs[None], 1 + len(delays), axis=0)
    for i, j in enumerate(delays, 1):
        for k in (k for k, name in enumerate(simulator.inputs) if delay_of(name) == simulator.free[j]):
            result[:, :, k] = np.interp(time - p[j], time, inputs[:, k])
            result[i, :, k] = np.interp(time - p[j] - DELAY_STEP, time, inputs[:, k])
    return result


def kept_sources(model: ReducedModel) -> dict[str, str]:
    """The files of `sources`, from the cache of the user if they were generated before."""
    eqs = model.equations
    function = ca.Function("model", [eqs.x, eqs.u, eqs.p], [eqs.dx, eqs.y, eqs.require])
    names = (model.states, model.inputs, model.parameters, model.outputs, model.estimated, eqs.statements)
    declared = [model.quantities[n] for n in (*model.states, *model.inputs, *model.parameters)]
    described = (ca.CasadiMeta.version(), function.serialize(), repr((names, model.dynamic, declared)))
    folder = files("fmus.identification.refinement")
    code = (folder / "compiled_model.py").read_bytes()
    dependencies = [*(text.encode() for text in described), code, *generator_sources()]
    return dict(json.loads(kept("refined.json", lambda: json.dumps(sources(model)).encode(), dependencies)))


def sources(model: ReducedModel) -> dict[str, str]:
    """Generated files by name: sizes.h and model.c as in an FMU, sens_lengths.h and sens.c."""
    routines, lengths, patterns = sensitivity_code(model)
    names = {"x": list(model.states), "u": list(model.inputs), "p": list(model.parameters)}
    tables = []
    for name, pattern in patterns.items():
        rows = [f"    {{{i}, {j}}}," for i, j in pattern] or ["    {0, 0},"]
        tables += [f"static const int {name}[][2] = {{ /* row and column */", *rows, "};", ""]
    listed = ", ".join(f"{name} = {n}" for name, n in {**lengths, "WIDTH": WIDTH}.items())
    return generated(_interface(model), "") | {
        "sens_lengths.h": f"enum {{ {listed} }};\n",
        "sens.c": "\n".join(['#include "sens.h"', *tables, *(c_function(r, names) for r in routines)]),
    }


def _interface(model: ReducedModel) -> Interface:
    """The model in the form of an FMU interface, without start values: one library serves all values."""
    groups: list[list[Variable]] = []
    kinds: tuple[tuple[Kind, Sequence[str], str], ...] = (
        ("FIXED", model.parameters, ""),
        ("INPUT", model.inputs, ""),
        ("STATE", model.states, ""),
        ("DERIVATIVE", model.states, "der_"),
    )
    for kind, names, prefix in kinds:
        declared = [(prefix + name, model.quantities[name]) for name in names]
        groups.append([Variable(n, kind, Quantity(q.unit, q.text, q.nominal), None) for n, q in declared])
    groups.append([])  # outputs are in sens.c only
    equations = replace(model.equations, y=ca.SX(0, 1))
    # declared stiff by default, so that only the implicit method is used; only that one has sensitivities
    return make_interface("refined", "A model for output error", groups, equations, ca.SX(0, 1))


def library(generated_files: Mapping[str, str]) -> ctypes.CDLL:
    """The shared library of a model from generated and hand-written files."""
    code = {name: text for name, text in native_sources(2).items() if name in C_FILES or name.endswith(".h")}
    native = files("fmus.identification.refinement") / "native"
    code |= {name: (native / name).read_text(encoding="utf-8") for name in ("sens.h", "sensitivities.c")}
    code |= generated_files
    code["all.c"] = "".join(f'#include "{name}"\n' for name in C_FILES)
    encoded = {name: text.encode() for name, text in code.items()}
    arguments = [*COMPILER_FLAGS, "all.c", "-lm"]
    return ctypes.CDLL(str(shared_library(f"refined{SUFFIX}", encoded, arguments, [_cpu_description()])))


@cache
def _cpu_description() -> bytes:
    """The compiler's description of this processor, for the key of the build cache."""
    command = [sys.executable, "-m", "ziglang", "build-exe", "--show-builtin"]
    return subprocess.run(command, capture_output=True, check=False).stdout


# ---- reduced model and its sensitivities --------------------------------------------------------------


@dataclass(frozen=True)
class ReducedModel:
    """The part of a subsystem that the chosen outputs depend on.

    states, inputs   names of those that the outputs depend on, in the order of the declaration
    parameters       names of all parameters (p)
    estimated        names of the parameters to be estimated (q), a subset of p
    dynamic          indices in q that f or the outputs depend on; the others affect only the initial state
    quantities       declaration of each variable by name
    equations        equations of the reduced model; its initial state is x itself
    q                symbols of the parameters to be estimated
    start, all_x     initial states as expressions of all_x (all states of the full model), u and p
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    estimated: tuple[str, ...]
    dynamic: tuple[int, ...]
    quantities: dict[str, Quantity]
    equations: Symbolic
    q: ca.SX
    start: ca.SX
    all_x: ca.SX


def reduce_model(sub: Subsystem, outputs: Sequence[str], estimated: Sequence[str]) -> ReducedModel:
    """The subsystem without the states and inputs that have no effect on these outputs."""
    sym = symbolic(sub)
    groups = {g: quantities(getattr(sub, g)) for g in ("states", "inputs", "parameters", "outputs")}
    for article, causality, names in (("an", "output", outputs), ("a", "parameter", estimated)):
        for name in names:
            if name not in groups[causality + "s"]:
                expected = ", ".join(groups[causality + "s"])
                raise Problem(f"{sub.name}: {name} is not {article} {causality}; expected one of {expected}")
            if (count := list(names).count(name)) > 1:
                raise Problem(f"{sub.name}: {causality} {name}: expected once, got {count} times")
    order = {group: list(declared) for group, declared in groups.items()}
    y = column(*(sym.y[order["outputs"].index(name)] for name in outputs))
    states = _required_states(sym.dx, y, sym.x)
    if not states:
        listed = ", ".join(outputs)
        raise Problem(f"{sub.name}: {listed} depend on no state, so that there is nothing to identify")
    x, dx, start = (column(*(v[i] for i in states)) for v in (sym.x, sym.dx, sym.start))
    inputs = sorted(_dependencies(column(dx, y, start), sym.u))
    u = column(*(sym.u[i] for i in inputs))
    requirements = [i for i in range(len(sym.statements)) if _depends_only_on(sym.require[i], x, u, sym.p)]
    q = column(*(sym.p[order["parameters"].index(name)] for name in estimated))
    return ReducedModel(
        states=tuple(order["states"][i] for i in states),
        inputs=tuple(order["inputs"][i] for i in inputs),
        parameters=tuple(groups["parameters"]),
        outputs=tuple(outputs),
        estimated=tuple(estimated),
        dynamic=tuple(sorted(_dependencies(column(dx, y), q))),
        quantities={name: quantity for group in groups.values() for name, quantity in group.items()},
        equations=replace(
            sym,
            x=x,
            u=u,
            dx=dx,
            y=y,
            start=x,
            calculated=(),
            require=column(*(sym.require[i] for i in requirements)),
            statements=tuple(sym.statements[i] for i in requirements),
            next_event=ca.SX.inf(),  # no time events: the step-size control alone resolves jumps of a rate
        ),
        q=q,
        start=start,
        all_x=sym.x,
    )


def _required_states(dx: ca.SX, y: ca.SX, x: ca.SX) -> list[int]:
    """Indices of the states that y depends on, of those that their derivatives depend on, and so on."""
    required: set[int] = set()
    new = _dependencies(y, x)
    while new:
        required |= new
        new = _dependencies(column(*(dx[i] for i in sorted(new))), x) - required
    return sorted(required)


def _dependencies(value: ca.SX, symbols: ca.SX) -> set[int]:
    """Indices of the symbols that a value depends on."""
    return set(ca.jacobian_sparsity(value, symbols).get_triplet()[1])


def _depends_only_on(value: ca.SX, *symbols: ca.SX) -> bool:
    """Is each symbol that a value depends on one of these?"""
    allowed = column(*symbols)
    return all(ca.depends_on(allowed, s) for s in ca.symvar(value) if ca.depends_on(value, s))


def sensitivity_code(
    model: ReducedModel,
) -> tuple[list[Routine], dict[str, int], dict[str, Sequence[Entry]]]:
    """All functions that native/sensitivities.c calls in addition to those of an FMU.

    Also the lengths of the vectors between them, and sparsity patterns as (row, column).
    """
    eqs, q = model.equations, column(*(model.q[i] for i in model.dynamic))
    x, u, p, y = eqs.x, eqs.u, eqs.p, eqs.y
    jacobian = without_zero_calls(ca.jacobian(eqs.dx, x))
    system = eliminate(jacobian)
    k, h_du = ca.SX.sym("k", x.numel()), ca.SX.sym("h_du", u.numel())
    hessian, hessian_symbols, product_x, product_q = _second_derivatives(eqs, jacobian, q, column(k, h_du))
    f_q = nonzeros(ca.jacobian(eqs.dx, q))
    for entry, value in product_q.items():
        f_q[entry] = f_q[entry] + value if entry in f_q else value
    y_x, y_q = nonzeros(ca.jacobian(y, x)), nonzeros(ca.jacobian(y, q))
    # contribution of the state sensitivities to the output sensitivities
    dx, by_x = ca.SX.sym("dx", x.numel()), ca.SX.sym("y_x", len(y_x))
    dy = ca.densify(ca.mtimes(_sparse(y_x, [by_x], y.numel(), x.numel()), dx))
    values = {
        "hessian": hessian,
        "jac": system.entries,
        "f_q": column(*f_q.values()),
        "y": y,
        "y_x": column(*y_x.values()),
        "y_q": column(*y_q.values()),
    }
    values, d, prepared = hoist({name: ca.densify(value) for name, value in values.items()}, p)
    arguments = {"x": x, "u": u, "p": p, "d": d}
    stage = {"jac": values["jac"], "product": column(*product_x.values()), "f_q": values["f_q"]}
    routines = [
        Routine("sens_prepare", {"p": p}, {"d": prepared}),
        Routine("sens_hessian", arguments, {"hessian": values["hessian"]}),
        Routine("sens_stage", arguments | {"hessian": hessian_symbols, "k": k, "h_du": h_du}, stage),
        Routine("sens_outputs", arguments, {"y": values["y"]}),
        Routine("sens_output_jacobians", arguments, {"y_x": values["y_x"], "y_q": values["y_q"]}),
        _stage_columns(system, nonzeros(jacobian), list(product_x)),
        Routine("sens_output_columns", {"y_x": by_x, "dx": dx}, {"dy": dy}, frozenset({"dx", "dy"})),
    ]
    vectors = {"NQ": q, "NOUT": y, "ND": d, "NHESSIAN": hessian}
    entries = {"NPRODUCT": product_x, "NF_Q": f_q, "NY_X": y_x, "NY_Q": y_q}
    lengths = {name: vector.numel() for name, vector in vectors.items()}
    lengths |= {name: len(nonzero) for name, nonzero in entries.items()}
    return routines, lengths, {"F_Q": list(f_q), "Y_Q": list(y_q)}


def _second_derivatives(
    eqs: Symbolic, jacobian: ca.SX, q: ca.SX, directions: ca.SX
) -> tuple[ca.SX, ca.SX, Entries, Entries]:
    """The second derivatives of f that are not structurally zero, symbols for them, and two products.

    The products are those of the second derivatives by x and by q with the directions (k, h du).
    """
    by_u = without_zero_calls(ca.jacobian(eqs.dx, eqs.u))
    first = ca.mtimes(ca.horzcat(jacobian, by_u), directions)
    by_x, by_q = (nonzeros(without_zero_calls(ca.jacobian(first, v))) for v in (eqs.x, q))
    hessian = ca.jacobian(column(*by_x.values(), *by_q.values()), directions)
    # linear in the directions, which CasADi does not see in the calls of functions
    hessian = without_zero_calls(ca.substitute(hessian, directions, ca.SX.zeros(directions.numel())))
    symbols = ca.SX.sym("hessian", hessian.nnz())
    products = ca.mtimes(ca.SX(hessian.sparsity(), symbols), directions)
    product_x = {entry: products[i] for i, entry in enumerate(by_x)}
    product_q = {entry: products[i] for i, entry in enumerate(by_q, len(by_x))}
    return column(*hessian.nonzeros()), symbols, product_x, product_q


def _stage_columns(system: Elimination, jacobian: Entries, product: Sequence[Entry]) -> Routine:
    """dk = M^-1 (J dX + H dx + r) with the factors of M; H holds the products of the second derivatives."""
    n = system.b.numel()
    dX, dx, r = (ca.SX.sym(name, n) for name in ("dX", "dx", "r"))
    symbols = ca.SX.sym("product", len(product))
    variable_entries = iter(ca.vertsplit(system.jac))
    J = [value if value.is_constant() else next(variable_entries) for value in jacobian.values()]
    b = r + ca.mtimes(_sparse(jacobian, J, n, n), dX) + ca.mtimes(_sparse(product, [symbols], n, n), dx)
    inputs = {"jac": system.jac, "product": symbols, "lu": system.lu, "dX": dX, "dx": dx, "r": r}
    dk = ca.substitute(system.k, system.b, b)
    return Routine("sens_stage_columns", inputs, {"dk": dk}, frozenset({"dX", "dx", "r", "dk"}))


def _sparse(entries: Iterable[Entry], values: Sequence[ca.SX], rows: int, columns: int) -> ca.SX:
    """Sparse matrix from the values of its entries."""
    pairs = list(entries)
    return ca.SX.triplet([i for i, _ in pairs], [j for _, j in pairs], column(*values), rows, columns)
