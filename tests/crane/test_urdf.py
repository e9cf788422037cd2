"""Cranes as URDF: another library reads the same mechanics, and a foreign URDF becomes a crane."""

from operator import attrgetter

import casadi as ca
import numpy as np
import pytest
from crane.rigid_bodies import mass_and_weight
from kit.cranes import checked, crane
from kit.mistakes import problem

from fmus.components.chain import Chain
from fmus.contract import nested
from fmus.crane.check import capacity, check
from fmus.crane.description import read
from fmus.crane.manipulator import manipulator
from fmus.crane.urdf import export, imported
from fmus.parameters import values

FOREIGN = """<robot name="arm"><link name="world"/>
<link name="Column 1"><inertial><origin xyz="0.1 0 0.4"/><mass value="200"/>
  <inertia ixx="10" iyy="11" izz="5" ixy="0.3" ixz="0.2" iyz="0.1"/></inertial></link>
<link name="bracket"><inertial><origin xyz="0 0.1 0" rpy="0.3 0.2 0.1"/><mass value="30"/>
  <inertia ixx="1" iyy="2" izz="1.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="0 0 1.2"/><mass value="150"/>
  <inertia ixx="60" iyy="60" izz="2" ixy="0" ixz="1" iyz="0"/></inertial></link>
<link name="slide"><inertial><origin xyz="0.2 0 0"/><mass value="40"/>
  <inertia ixx="1" iyy="4" izz="4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="continuous"><parent link="world"/><child link="Column 1"/><origin xyz="0 0 0.5"/>
  <axis xyz="0 0 1"/></joint>
<joint name="j2" type="fixed"><parent link="Column 1"/><child link="bracket"/>
  <origin xyz="0.2 0 0.9" rpy="0 0 1.5707963267948966"/></joint>
<joint name="j3" type="revolute"><parent link="bracket"/><child link="arm"/>
  <origin xyz="0 -0.1 0.2" rpy="1.5707963267948966 0 0"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/><dynamics damping="7"/></joint>
<joint name="j4" type="prismatic"><parent link="arm"/><child link="slide"/>
  <origin xyz="0 0 2.5" rpy="0 -1.5707963267948966 0"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def same(pin, crane, text, q):
    """M and G of a crane whose joints are all free are those of Pinocchio's reader, within rounding."""
    sub = manipulator(crane)
    own = sub.dynamics.__self__
    chain = own.chain(nested(own.parameters, values(sub).p))
    links = [type(link)(**{**vars(link), "follows": None}) for link in chain.links]
    motion = Chain(tuple(links), (0, 0, -9.81)).equations(ca.SX(q), ca.SX(0 * q))
    model = pin.buildModelFromXML(text)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    place = pin.integrate(model, pin.neutral(model), q)  # a continuous joint has the sine and cosine
    expected = mass_and_weight(pin, model, model.createData(), place)
    for own, other in zip((motion.mass, ca.vec(motion.gravity)), expected, strict=True):
        found = ca.evalf(own).full().reshape(other.shape)
        np.testing.assert_allclose(found, other, rtol=0, atol=1e-12 * np.abs(other).max())


def test_an_export_has_the_same_mechanics_in_pinocchio(pin):
    """M and G of the loader at random coordinates, its second stage as a joint of its own."""
    text = export(crane(), checked()).replace('<mimic joint="extension_joint" multiplier="1"/>', "")
    for q in np.random.default_rng(4).uniform(-1, 1, (20, 7)):
        same(pin, crane(), text, q)


def test_a_foreign_urdf_becomes_a_crane_with_the_same_mechanics(pin, tmp_path):
    """Turned frames are turned back, the link of a fixed joint is a part of its carrier."""
    source, target = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    source.write_text(FOREIGN, encoding="utf-8")
    told = imported(source, target)
    assert "3 joints" in told
    assert "column1, arm, slide" in told
    found = read(target)
    assert capacity(found, check(found)).values[2] == 0.0  # nothing is driven yet
    assert [j["damping"] for j in found.joints] == [0, 7, 0]
    for q in np.random.default_rng(5).uniform(-1, 1, (20, 3)):
        same(pin, found, FOREIGN, q)


def test_an_exported_crane_comes_back(tmp_path):
    """All numbers of links and joints, also the coupled stage."""
    (tmp_path / "a.urdf").write_text(export(crane(), checked()), encoding="utf-8")
    imported(tmp_path / "a.urdf", tmp_path / "a.toml")
    again = read(tmp_path / "a.toml")
    same_of = attrgetter("name", "kind", "axis", "parent", "follows")
    for one, other in zip(crane().joints, again.joints, strict=True):
        assert same_of(one) == same_of(other)
        kept = [n for n in other.numbers if n != "stiffness"]
        assert [one[n] for n in kept] == pytest.approx([other[n] for n in kept], abs=1e-11)


TURN = 'rpy="1.5707963267948966 0 0'
REFUSED = {
    "j4: expected a revolute, prismatic or fixed joint, got floating": ("prismatic", "floating"),
    "j3: expected an axis along x, y or z with all joints at 0": (TURN, 'rpy="0.3 0 1'),
    "expected one link without a parent": ('<link name="world"/>', '<link name="world"/><link name="b"/>'),
    "expected a URDF: Opening and ending tag mismatch": ("<robot", "<robots"),
    "expected a URDF: could not convert string": ('xyz="0 0 0.5"', 'xyz="0 0 a"'),
}


@pytest.mark.parametrize(("line", "change"), REFUSED.items())
def test_what_a_crane_cannot_have_is_told(tmp_path, line, change):
    """With the file, the joint, what was expected and what was found."""
    source = tmp_path / "arm.urdf"
    source.write_text(FOREIGN.replace(*change), encoding="utf-8")
    assert f"{source}: {line}" in problem(lambda: imported(source, tmp_path / "arm.toml"))
