"""Calls of functions in CasADi expressions: which function an instruction calls, and calls that give zero.

A CasADi function with the option `never_inline` stays a call in larger expressions, and its derivatives are
calls, too: fwd1_NAME with a seed for each input, adj1_NAME with a seed for each output. CasADi does not
notice that such a call gives zero because all its seeds are zero. `without_zero_calls` removes these.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate

import casadi as ca


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


def rebuilt(values: ca.SX, binary: Callable[[int, ca.SX, ca.SX], ca.SX] = ca.SX.binary) -> ca.SX:
    """The same values, instruction by instruction; `binary` makes the results of operations of two values."""
    symbols = ca.symvar(values)
    function = ca.Function("f", symbols, [values])
    calls = called(function)
    work = [ca.SX(0)] * function.sz_w()
    result = [ca.SX(0)] * values.nnz()
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        o, i = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            result[o[1]] = work[i[0]]
        elif operation == ca.OP_INPUT:
            work[o[0]] = symbols[i[0]]
        elif operation == ca.OP_CONST:
            work[o[0]] = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_CALL:
            results = _results(callee(calls, i, o), [work[j] for j in i])
            for j, value in zip(o, results, strict=True):
                if j >= 0:
                    work[j] = value
        elif len(i) == 1:
            work[o[0]] = ca.SX.unary(operation, work[i[0]])
        else:
            work[o[0]] = binary(operation, work[i[0]], work[i[1]])
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
