"""A machine with other joints, levers and task is drawn and driven by its own file alone."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from kit import shards
from kit.driven_page import Opened, hold
from kit.mistakes import problem, table
from kit.toy import toy

from fmus import parameters
from fmus.contract import Quantity, Subsystem
from fmus.export.build import build, build_all
from orchestrator.base.signals import bare_name
from orchestrator.base.toml import read, read_dataclass
from orchestrator.drive.page import write_page
from orchestrator.drive.sticks import StickAxes, commands, functions, modes
from orchestrator.drive.view_description import ViewDescription
from orchestrator.realtime.stepping import FrameStepper
from orchestrator.view.choice import MachineChoice, plan

VIEW = Path(__file__).with_name("loader.toml")
JOINTS = {"mast": "rad", "lift": "rad", "extension": "m"}
LEVERS = ("mast_lever", "lift_lever", "telescope_lever")
SPEED = 0.3  # rad/s or m/s at a lever of 1
START = {"mast": 0.4, "lift": 0.2, "extension": 0.1}


def loader(folder: Path) -> Subsystem:
    """A mast that turns, an arm that lifts, a telescope; each lever commands a speed."""
    numbers = {"pivot_height": 1.2, "arm_length": 2.5} | {f"{name}_start": at for name, at in START.items()}
    units = {name: "m" for name in ("pivot_height", "arm_length")}
    units |= {f"{name}_start": unit for name, unit in JOINTS.items()}
    outputs = {f"{name}_seen": unit for name, unit in JOINTS.items()}
    outputs |= dict.fromkeys(("end_x", "end_y", "end_z"), "m")
    outputs |= dict.fromkeys(("outwards_velocity", "rising_velocity"), "m/s")
    outputs |= dict.fromkeys(("mast_speed", "lift_speed"), "rad/s")

    def speeds(u: Any) -> dict[str, Any]:
        return {name: SPEED * getattr(u, lever) for name, lever in zip(JOINTS, LEVERS, strict=True)}

    def observe(x: Any, u: Any, p: Any) -> dict[str, Any]:
        long, rates = p.arm_length + x.extension, speeds(u)
        out, up = long * ca.cos(x.lift), long * ca.sin(x.lift)
        seen = {f"{name}_seen": getattr(x, name) for name in JOINTS}
        seen |= {"end_x": out * ca.cos(x.mast), "end_y": out * ca.sin(x.mast), "end_z": p.pivot_height + up}
        seen["outwards_velocity"] = rates["extension"] * ca.cos(x.lift) - up * rates["lift"]
        seen["rising_velocity"] = rates["extension"] * ca.sin(x.lift) + out * rates["lift"]
        return seen | {"mast_speed": rates["mast"], "lift_speed": rates["lift"]}

    p = {name: Quantity(units[name], "of the loader", value=value) for name, value in numbers.items()}
    groups = p, JOINTS, dict.fromkeys(LEVERS, "1"), outputs
    initial = {"initial": lambda _x, _u, p: {name: getattr(p, f"{name}_start") for name in JOINTS}}
    sub = toy("loader", *groups, lambda _x, u, _p: speeds(u), observe, **initial)
    (folder / "view.toml").write_bytes(VIEW.read_bytes())
    declared = parameters.numbers(replace(sub, values=None))
    return replace(sub, values=folder / "parameters.toml", numbers=declared)


def test_driven(tmp_path: Path) -> None:
    """The levers move what its file says, from its start values; its task finds its signals."""
    found = plan(MachineChoice(build(loader(tmp_path), tmp_path, fmi=3)))
    described, names = found.description, [axis.name for axis in found.setup.axes]
    assert names == list(LEVERS)
    assert modes(described.modes, names) == ("hand",)
    pulled = functions(StickAxes(left_x=-1.0, left_y=1.0, right_y=-1.0), described.patterns["loader"])
    wanted = commands(pulled, described.modes["hand"], names)
    assert wanted == {"mast_lever": 1.0, "lift_lever": 0.5, "telescope_lever": 1.0}
    with closing(FrameStepper(found.setup)) as live:
        for _ in range(101):
            live.advance(np.array([wanted[name] for name in names]))
        values = dict(zip(map(bare_name, found.setup.signals), live.values, strict=True))
    # 1 s at the speed of the levers, and the ramp of the first frame
    moved = {"mast": SPEED, "lift": 0.5 * SPEED, "extension": SPEED}
    for name, way in moved.items():
        assert values[f"{name}_seen"] == pytest.approx(START[name] + 1.005 * way, rel=1e-6)
    assert set(described.task.needed) <= set(values)


@pytest.fixture
def opened(chromium: Any, tmp_path: Path) -> Iterator[Opened]:
    """Its page."""
    (file,) = build_all([loader(tmp_path)], {3: tmp_path}, wasm=["loader"])[3]
    page = Opened(chromium, write_page(tmp_path / "loader.html", file, "Loader"))
    yield page
    page.context.close()


@shards.browser
def test_drawn(opened: Opened) -> None:
    """Driven by keys, its drawing follows: the tip is where the equations have it; the words are its own."""
    opened.page.locator(".hm-stage").focus()
    for key in ("a", "w", "ArrowDown"):
        hold(opened, key, 0.5)
    opened.page.keyboard.press("p")
    values = opened.ask("source.values")
    moved = {name: values[f"{name}_seen"] - start for name, start in START.items()}
    assert min(moved.values()) > 0.02, moved
    # exact identity, rounding only
    assert opened.ask("scene.rig.tip") == pytest.approx([values[f"end_{axis}"] for axis in "xyz"], abs=1e-12)
    opened.page.get_by_role("button", name="mirrored").click()
    texts = "[...s.svg.querySelectorAll('text')].map((t) => t.textContent)"
    words = opened.ask(f"levers.screen.map((s) => {texts})")
    assert words[0] == ["lower", "raise", "", ""]
    assert opened.complaints == []


@table(__file__, "mistakes", "old, new, message")
def test_mistakes(old: str, new: str, message: str) -> None:
    """A name that does not exist, a formula that is none: one line with what was expected."""
    text = VIEW.read_text(encoding="utf-8")
    assert old in text
    wrong = text.replace(old, new, 1).encode()
    assert message in problem(lambda: read_dataclass(ViewDescription, read(VIEW, wrong)))
