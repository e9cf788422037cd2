"""Calls of functions in CasADi expressions: which function an instruction calls, and calls that give zero.

A CasADi function with the option `never_inline` stays a call in larger expressions, and its derivatives are
calls, too: fwd1_NAME with a seed for each input, adj1_NAME with a seed for each output. CasADi does not
notice that such a call gives zero because all its seeds are zero. `without_zero_calls` removes these.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate

import casadi as ca

Instruction = tuple[int, list[int], list[int]]  # operation, indices of its results, and of its arguments


def instructions(function: ca.Function) -> list[Instruction]:
    """The instructions of a function, each asked for once: a question to CasADi takes a microsecond."""
    operation, results = function.instruction_id, function.instruction_output
    arguments = function.instruction_input
    return [(operation(k), results(k), arguments(k)) for k in range(function.n_instructions())]


def called(function: ca.Function) -> list[ca.Function]:
    """The functions that a function calls directly."""
    return [function.get_function(name) for name in function.get_function()]


def callee(calls: Sequence[ca.Function], inputs: Sequence[int], outputs: Sequence[int]) -> ca.Function:
    """The called function with so many entries of inputs and outputs: CasADi does not name it."""
    found = [f for f in calls if (f.nnz_in(), f.nnz_out()) == (len(inputs), len(outputs))]
    if len(found) != 1:
        names = ", ".join(f.name() for f in calls)
        raise ValueError(f"call of one of {names}: expected one of {len(inputs)} inputs, got {len(found)}")
    return found[0]


def input_bounds(function: ca.Function) -> list[tuple[int, int]]:
    """(first, last + 1) of the entries of each input in a call."""
    return _bounds([function.nnz_in(n) for n in range(function.n_in())])


def output_bounds(function: ca.Function) -> list[tuple[int, int]]:
    """(first, last + 1) of the entries of each output in a call."""
    return _bounds([function.nnz_out(n) for n in range(function.n_out())])


def _bounds(sizes: Sequence[int]) -> list[tuple[int, int]]:
    ends = list(accumulate(sizes))
    return list(zip([0, *ends[:-1]], ends, strict=True))


def without_zero_calls(values: ca.SX) -> ca.SX:
    """The same values without calls of derivatives whose seeds are all zero, and what follows from that."""
    function = ca.Function("f", ca.symvar(values), [values])
    if not any(f.name().startswith(("fwd1_", "adj1_")) for f in called(function)):
        return values
    return rebuilt(values)


def rebuilt(
    values: ca.SX, p: ca.SX | None = None, by_parameters: Callable[[ca.SX, ca.SX], ca.SX] | None = None
) -> ca.SX:
    """The same values, instruction by instruction.

    by_parameters   makes the quotients of what depends on other symbols by what depends on those in p alone
    """
    symbols = ca.symvar(values)
    function = ca.Function("f", symbols, [values])
    calls = called(function)
    parameters = set() if p is None else {s.element_hash() for s in ca.vertsplit(p)}
    of_p = [s.element_hash() in parameters for s in symbols]
    work = [ca.SX(0)] * function.sz_w()
    alone = [True] * function.sz_w()  # does the value in `work` depend on p alone, or on nothing?
    result = [ca.SX(0)] * values.nnz()
    for k, (operation, o, i) in enumerate(instructions(function)):
        if operation == ca.OP_OUTPUT:
            result[o[1]] = work[i[0]]
            continue
        if operation == ca.OP_INPUT:
            work[o[0]], alone[o[0]] = symbols[i[0]], of_p[i[0]]
            continue
        from_p = [alone[j] for j in i]
        if operation == ca.OP_CONST:
            work[o[0]] = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_CALL:
            results = _results(callee(calls, i, o), [work[j] for j in i])
            for j, value in zip(o, results, strict=True):
                if j >= 0:
                    work[j], alone[j] = value, all(from_p) or value.is_constant()
            continue
        elif len(i) == 1:
            work[o[0]] = ca.SX.unary(operation, work[i[0]])
        elif operation == ca.OP_DIV and by_parameters and from_p == [False, True]:
            work[o[0]] = by_parameters(work[i[0]], work[i[1]])
        else:
            work[o[0]] = ca.SX.binary(operation, work[i[0]], work[i[1]])
        alone[o[0]] = all(from_p)
    return ca.SX(values.sparsity(), ca.vertcat(*result))


def _results(function: ca.Function, arguments: Sequence[ca.SX]) -> list[ca.SX]:
    """The entries of all outputs of a call."""
    bounds = input_bounds(function)
    first_seed = _first_seed(function)
    if first_seed is not None and all(a.is_zero() for a in arguments[bounds[first_seed][0] :]):
        return [ca.SX(0)] * function.nnz_out()
    sparsities = [function.sparsity_in(n) for n in range(function.n_in())]
    vectors = [
        ca.SX(sparsity, ca.vertcat(*arguments[slice(*entries)])) if sparsity.nnz() else ca.SX(sparsity)
        for sparsity, entries in zip(sparsities, bounds, strict=True)
    ]
    return [entry for output in function.call(vectors) for entry in ca.vertsplit(ca.SX(output.nz[:]))]


def _first_seed(function: ca.Function) -> int | None:
    """Index of the first input that is a seed; None for a function that is no derivative.

    The inputs of a derivative of f are those of f, its outputs, and the seeds.
    """
    inputs, outputs = function.n_in(), function.n_out()
    if not function.name().startswith(("fwd1_", "adj1_")):
        return None
    # of f with n inputs, m outputs: fwd1 has 2 n + m inputs and m outputs, adj1 has n + 2 m and n
    return (inputs + outputs) // 2
