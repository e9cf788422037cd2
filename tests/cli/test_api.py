"""What `import fmus` offers: a subsystem declared, built and composed in code alone."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kit.fmu import driving
from kit.mistakes import problem
from kit.toy import toy

import fmus
from fmus.contract import flat, nested, symbolic
from fmus.parameters import numbers


@pytest.fixture(scope="module")
def example() -> dict:
    """The lines under `import fmus` in the docstring of the package, without those that build."""
    lines = fmus.__doc__.partition("    import fmus\n")[2].partition("    fmus.build(")[0]
    room: dict = {"fmus": fmus}
    exec("\n".join(line.removeprefix("    ") for line in lines.splitlines()), room)
    return room


def test_the_example_of_the_package_builds_and_runs(example, tmp_path):
    """A first order lag with its number in the code: 1 - exp(-t/T) after a step."""
    path = fmus.build(example["lag"], tmp_path)
    with driving(path, commanded=1.0) as fmu:
        level = fmu.step(0.01, 100)["level"]
    # solver tolerance 1e-6 of the FMU
    assert level == pytest.approx(1 - np.exp(-1 / 0.5), rel=1e-5)


def test_numbers_in_the_code_are_told_as_such(example):
    """Value and unit of the declaration; start values that are not stated are zero."""
    lag = example["lag"]
    assert fmus.values(lag) == fmus.Values({"lag": 0.5}, {"commanded": 0.0}, {"level": 0.0})
    assert numbers(lag)["parameters"]["lag"].note == "stated in the code"


def test_a_parameter_without_a_number_is_refused():
    """Neither file nor value: one line that names it."""
    sub = toy("empty", {"lag": fmus.Quantity("s", "Time constant")}, {}, {}, {}, None, None)
    problem(lambda: fmus.values(replace(sub, values=None)), "^empty: parameter lag of empty is missing$")


def test_several_become_one(example):
    """Two lags in a row: the second follows the first."""
    parts = dict.fromkeys(("first", "second"), example["lag"])
    wires, inputs = [("first.level", "second.commanded")], {"commanded": ["first.commanded"]}
    both = fmus.compose("both", "Two lags", parts, wires, inputs)
    assert list(fmus.quantities(both.states)) == ["first_level", "second_level"]
    dx, _ = symbolic(both).function()([0.5, 0.25], [1.0], list(fmus.values(both).p.values()))
    np.testing.assert_allclose(dx.full()[:, 0], [1.0, 0.5])


def test_a_group_is_used_twice_with_prefixes():
    """Fields, texts, headings and rates carry the prefix; `of` takes the group out again."""

    class Wheel(fmus.Group):
        speed: fmus.Scalar = fmus.Quantity("rad/s", "Speed of the {} wheel", rate="turn", group="{} wheel")
        turn: fmus.Scalar = fmus.Quantity("rad/s2", "Acceleration of the {} wheel")

    class Cart(fmus.Group, front=Wheel, back=(Wheel, "rear")):
        mass: fmus.Scalar = fmus.Quantity("kg", "Mass", value=2.0)

    found = fmus.quantities(Cart)
    assert list(found) == ["front_speed", "front_turn", "back_speed", "back_turn", "mass"]
    assert found["back_speed"].text == "Speed of the rear wheel"
    assert (found["front_speed"].group, found["front_speed"].rate) == ("Front wheel", "front_turn")
    cart = Cart(front=Wheel(speed=1, turn=2), back=Wheel(speed=3, turn=4))
    assert (cart.mass, cart.back.turn) == (2.0, 4)
    values = {"front_speed": 1, "front_turn": 2, "back_speed": 3, "back_turn": 4, "mass": 2.0}
    assert flat(cart) == values
    assert nested(Cart, values) == cart


def test_two_variables_of_one_name_are_refused():
    """A group and a field, or two groups without a prefix."""

    class Wheel(fmus.Group):
        speed: fmus.Scalar = fmus.Quantity("rad/s", "Speed")

    class Cart(fmus.Group, front=Wheel):
        front_speed: fmus.Scalar = fmus.Quantity("rad/s", "Speed")

    class Both(fmus.Group, front=(Wheel, "front", str), back=(Wheel, "back", str)):
        pass

    for group, name in ((Cart, "front_speed"), (Both, "speed")):
        told = f"^{group.__name__}: {name} is declared twice, expected different"
        problem(lambda group=group: fmus.quantities(group), told)


def test_the_registry_holds_every_variant():
    """Part, variant, subsystem; the usual one first and named like its part."""
    assert set(fmus.PARTS) == {"swing", "boom_stick", "manipulator", "supply"}
    for part, variants in fmus.PARTS.items():
        assert next(iter(variants.values())).name == part
        assert all(sub.component == part for sub in variants.values())


def test_the_names_are_there_and_the_import_is_light():
    """Every name resolves; `import fmus` alone loads neither CasADi nor NumPy."""
    assert all(getattr(fmus, name) is not None for name in fmus.__all__)
    with pytest.raises(AttributeError, match="no attribute 'wheel'"):
        _ = fmus.wheel
    code = "import sys, fmus; sys.exit(any(n in sys.modules for n in ('casadi', 'numpy', 'fmus.contract')))"
    root = Path(__file__).parents[2]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0
