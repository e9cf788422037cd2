"""What may stand in a model description: kinds of dependencies, names and numbers."""

import casadi as ca
from export.conftest import q, stateless
from kit.mistakes import problem, table

from fmus.export.interface import dependencies, interface_of
from fmus.parameters import Values

STEPWISE = {
    "chosen": lambda u: ca.if_else(u > 0, 2, 3),
    "whole": lambda u: 3 * u + ca.floor(u),
    "signed": lambda u: 2 * ca.sign(u),
    "wrapped": lambda u: ca.fmod(u, 2),
}


def test_stepwise_dependency_has_no_factor():
    """An output that jumps with its input is "dependent", though its derivative is constant (2.2.8)."""
    y = dict.fromkeys([*STEPWISE, "straight", "scaled"], "1")

    def observe(_x, u, p):
        return {n: f(u.u) for n, f in STEPWISE.items()} | {"straight": 3 * u.u, "scaled": p.k * u.u}

    sub = stateless("steps", {"u": "1"}, y, observe, {"k": "1"})
    table = dependencies(interface_of(sub, Values({"k": 1.0}, {"u": 0.0}, {})))
    kinds = {name: [(v.name, kind) for v, kind in table[name]] for name in y}
    assert {n: kinds[n] for n in STEPWISE} == {n: [("u", "dependent")] for n in STEPWISE}
    assert (kinds["straight"], kinds["scaled"]) == ([("u", "constant")], [("u", "fixed")])


@table(__file__, "refused", "name, more, start, words")
def test_what_a_description_cannot_have_is_refused(name, more, start, words):
    """Nominal values that are not positive, starts out of bounds; a name that is none of a file and in C."""
    sub = stateless(name, {"u": q(**more)}, {"y": "1"}, lambda _x, u, _p: {"y": u.u})
    problem(lambda: interface_of(sub, Values({}, {"u": start}, {})), words)
