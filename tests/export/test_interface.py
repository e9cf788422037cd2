"""What may stand in a model description: kinds of dependencies, names and numbers."""

import casadi as ca
import pytest
from kit.mistakes import table

from fmus.contract import Quantity
from fmus.export.interface import dependencies, interface_of
from fmus.parameters import Values
from orchestrator.base.errors import Problem


def q(**more):
    return Quantity("1", "of a toy", **more)


STEPWISE = {
    "chosen": lambda u: ca.if_else(u > 0, 2, 3),
    "whole": lambda u: 3 * u + ca.floor(u),
    "signed": lambda u: 2 * ca.sign(u),
    "wrapped": lambda u: ca.fmod(u, 2),
}


def test_stepwise_dependency_has_no_factor(make_toy):
    """An output that jumps with its input is "dependent", though its derivative is constant (2.2.8)."""
    one = q()
    y = {name: one for name in [*STEPWISE, "straight", "scaled"]}

    def observe(_x, u, p):
        return {n: f(u.u) for n, f in STEPWISE.items()} | {"straight": 3 * u.u, "scaled": p.k * u.u}

    sub = make_toy("steps", {"k": one}, {}, {"u": one}, y, lambda *_: {}, observe)
    table = dependencies(interface_of(sub, Values({"k": 1.0}, {"u": 0.0}, {})))
    kinds = {name: [(v.name, kind) for v, kind in table[name]] for name in y}
    assert {n: kinds[n] for n in STEPWISE} == {n: [("u", "dependent")] for n in STEPWISE}
    assert (kinds["straight"], kinds["scaled"]) == ([("u", "constant")], [("u", "fixed")])


@table(__file__, "numbers", "more, start, words")
def test_impossible_numbers_of_a_variable_are_refused(make_toy, more, start, words):
    """A nominal value that is not positive and a start value out of bounds are refused."""
    u = q(**more)
    sub = make_toy("odd", {}, {}, {"u": u}, {"y": q()}, lambda *_: {}, lambda _x, u, _p: {"y": u.u})
    with pytest.raises(Problem, match=words):
        interface_of(sub, Values({}, {"u": start}, {}))


def test_name_of_the_model_must_be_an_identifier(make_toy):
    """The model name must be an identifier, because it is a file name and a prefix of C functions."""
    one = q()
    sub = make_toy("two words", {}, {}, {"u": one}, {"y": one}, lambda *_: {}, lambda _x, u, _p: {"y": u.u})
    with pytest.raises(
        Problem, match='"two words" is not an identifier, expected a letter, then letters, digits or _'
    ):
        interface_of(sub, Values({}, {"u": 0.0}, {}))
