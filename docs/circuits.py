"""Draws the hydraulic diagrams of docs/machine.md, with parameters: `python docs/circuits.py`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from math import pi
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from hydraulic_symbols import Sheet

from fmus.machine.parts import FAMILIES
from fmus.parameters import complete

IMAGES = Path(__file__).parent / "images"


class Numbers:
    """Parameters of a variant by attribute."""

    def __init__(self, part: str, variant: str) -> None:
        self._table = complete(FAMILIES[part][variant])["parameters"]

    def __getattr__(self, name: str) -> float:
        return self._table[name].value


def bar(pressure: float) -> str:
    """A pressure [Pa] in bar."""
    return f"{pressure / 1e5:.0f} bar"


def flow(value: float) -> str:
    """A flow [m3/s] in L/min."""
    return f"{value * 6e4:.0f} L/min"


def per_revolution(displacement: float) -> str:
    """A displacement [m3/rad] in cm3 per revolution."""
    return f"{displacement * 2 * pi * 1e6:.0f} cm3/rev"


# ---- supplies


def supply_ideal() -> Sheet:
    """Pressure source."""
    p, s = Numbers("supply", "ideal"), Sheet(300, 150, "Supply, variant ideal: a pressure source")
    s.source(90, 100)
    s.line([(90, 84), (90, 40)])
    s.text(90, 32, "P", "middle")
    s.text(112, 100, bar(p.pressure_setting) + "\nat any flow")
    s.line([(220, 40), (220, 92)])
    s.text(220, 32, "T", "middle")
    s.tank(220, 100)
    return s


def _pump_line(s: Sheet, x: float, label: str, y: float = 220) -> None:
    """Pump with suction line and check valve up to y = 70."""
    s.pump(x, y)
    s.line([(x, y + 20), (x, y + 36)])
    s.tank(x, y + 44)
    s.line([(x, y - 20), (x, 119)])
    s.check(x, 110, "up")
    s.line([(x, 101), (x, 70)])
    s.text(x + 26, y + 20, label)


def _engine(s: Sheet, x: float, y: float, ends: float, speed: float, power: float) -> None:
    s.engine(x, y, "Diesel")
    s.text(x, y + 34, f"{power / 1e3:.0f} kW\n{speed * 60 / (2 * pi):.0f} rpm", "middle")
    for shift in (-2, 2):
        s.line([(x + 26, y + shift), (ends, y + shift)], width=1)


def _main_relief(s: Sheet, x: float, label: str) -> None:
    s.node(x, 70)
    s.line([(x, 70), (x, 128)])
    s.relief(x, 150, label=label)
    s.line([(x, 172), (x, 200)])
    s.tank(x, 208)


def supply_engine_pump() -> Sheet:
    """Two pressure-compensated pumps."""
    p = Numbers("supply", "engine_pump")
    s = Sheet(620, 310, "Supply, variant engine_pump: two pressure-compensated pumps on a diesel engine")
    _engine(s, 60, 220, 140, p.engine_rated_speed, p.engine_rated_speed * p.engine_rated_torque)
    s.line([(180, 218), (280, 218)], width=1)
    s.line([(180, 222), (280, 222)], width=1)
    for x, setting in ((160, p.pump_1_pressure_setting), (300, p.pump_2_pressure_setting)):
        _pump_line(s, x, f"{per_revolution(p.pump_displacement)}")
        s.node(x, 150)
        s.line([(x, 150), (x + 38, 150), (x + 38, 186), (x + 22, 197)], pilot=True)
        s.text(x + 42, 168, f"compensator\n{bar(setting)}")
    s.line([(160, 70), (540, 70)])
    s.text(548, 74, "P")
    _main_relief(s, 450, bar(p.relief_pressure))
    return s


def supply_load_sensing() -> Sheet:
    """Load-sensing pump."""
    p = Numbers("supply", "load_sensing")
    s = Sheet(
        620, 310, "Supply, variant load_sensing: a variable pump that holds a margin over the highest load"
    )
    _engine(s, 60, 220, 160, p.engine_rated_speed, p.engine_rated_speed * p.engine_rated_torque)
    _pump_line(s, 180, per_revolution(p.main_pump_displacement))
    s.frame(250, 130, 118, 62)
    s.text(309, 146, f"margin {bar(p.margin)}\ncut-off {bar(p.pressure_cut_off)}\npower limit", "middle")
    s.node(180, 150)
    s.line([(180, 150), (250, 150)], pilot=True)
    s.line([(280, 192), (203, 197)], pilot=True)
    s.line([(180, 70), (540, 70)])
    s.text(548, 74, "P")
    s.line([(368, 160), (400, 160), (400, 36), (540, 36)], pilot=True)
    s.text(548, 40, "LS")
    _main_relief(s, 470, bar(p.relief_pressure))
    return s


# ---- boom and stick


def _valve(s: Sheet, x: float, y: float, sensing: bool = False) -> None:
    s.four_way(x, y, sensing)
    s.line([(x - 9, y + 21), (x - 9, y + 46)])
    s.line([(x + 9, y + 21), (x + 9, y + 46)])


def _cylinder_label(p: Numbers, axis: str) -> str:
    bore, rod, stroke = (getattr(p, f"{axis}_{n}") for n in ("bore", "rod", "stroke"))
    return f"{axis.capitalize()} {bore * 1e3:.0f}/{rod * 1e3:.0f} mm, stroke {stroke * 1e3:.0f} mm"


def _hose_label(p: Numbers, axis: str) -> str:
    length, bore = (getattr(p, f"{axis}_hose_{n}") for n in ("length", "bore"))
    return f"{length:.1f} m\nbore {bore * 1e3:.1f} mm"


def _supply_lines(s: Sheet, x: float, y: float, spread: float) -> None:
    """P to the left, T to the right of a valve, from its ports."""
    s.line([(x - 9, y), (x - 9, y + 12), (x - spread, y + 12), (x - spread, y + 24)])
    s.text(x - spread, y + 38, "P", "middle")
    s.line([(x + 9, y), (x + 9, y + 12), (x + spread, y + 12), (x + spread, y + 24)])
    s.text(x + spread, y + 38, "T", "middle")


def _pair(s: Sheet, p: Numbers, draw: Callable[[Sheet, Numbers, str, float], None]) -> Sheet:
    for axis, x in (("boom", 150.0), ("stick", 470.0)):
        draw(s, p, axis, x)
    return s


def _drive(s: Sheet, p: Numbers, axis: str, x: float) -> None:
    """Cylinder, hoses, valve."""
    s.cylinder(x, 60, _cylinder_label(p, axis))
    for port, side in ((x - 44, "A"), (x + 34, "B")):
        s.line([(port, 76), (port, 98)])
        s.hose(port, 120, _hose_label(p, axis) if side == "B" else "")
        s.line([(port, 142), (port, 166)])
    s.line([(x - 44, 166), (x - 44, 176), (x - 9, 176), (x - 9, 190)])
    s.line([(x + 34, 166), (x + 34, 176), (x + 9, 176), (x + 9, 190)])
    _valve(s, x, 208)
    _supply_lines(s, x, 250, 40)


def boom_stick() -> Sheet:
    """The paper's circuit."""
    title = "Boom and stick, variants lumped and quasistatic: valve, hoses, cylinder"
    return _pair(Sheet(640, 300, title), Numbers("boom_stick", "lumped"), _drive)


def _relief_pair(s: Sheet, port: float, y: float, side: int, label: str) -> None:
    """Relief and anti-cavitation valve of a port to the tank, beside the line."""
    x = port + side * 62
    s.node(port, y)
    s.line([(port, y), (x, y), (x, y + 8)])
    s.relief(x, y + 30, label=label)
    s.line([(x, y + 52), (x, y + 60)])
    s.tank(x, y + 66)
    c = port + side * 160
    s.line([(x, y), (c, y), (c, y + 21)])
    s.check(c, y + 30, "up")
    s.line([(c, y + 39), (c, y + 60)])
    s.tank(c, y + 66)
    s.node(x, y)


def _detailed_drive(s: Sheet, p: Numbers, axis: str, x: float) -> None:
    s.cylinder(x, 60, _cylinder_label(p, axis))
    for port, side in ((x - 44, -1), (x + 34, 1)):
        s.line([(port, 76), (port, 198)])
        _relief_pair(s, port, 98, side, bar(p.relief_pressure) if side > 0 else "")
        s.hose(port, 220, _hose_label(p, axis) if side > 0 else "")
        s.line([(port, 242), (port, 256)])
    s.line([(x - 44, 256), (x - 44, 270), (x - 9, 270), (x - 9, 284)])
    s.line([(x + 34, 256), (x + 34, 270), (x + 9, 270), (x + 9, 284)])
    _valve(s, x, 302)
    s.text(x + 80, 296, f"spool {p.spool_frequency:.0f} Hz,\ndamping {p.spool_damping:.2g}")
    _supply_lines(s, x, 344, 40)


def boom_stick_detailed() -> Sheet:
    """With relief and anti-cavitation valves at the cylinder."""
    title = "Boom and stick, variant detailed: also relief and anti-cavitation valves at each cylinder port"
    s, p = Sheet(970, 400, title), Numbers("boom_stick", "detailed")
    for axis, x in (("boom", 240.0), ("stick", 720.0)):
        _detailed_drive(s, p, axis, x)
    return s


def _compensated_drive(s: Sheet, p: Numbers, axis: str, x: float) -> None:
    s.cylinder(x, 60, _cylinder_label(p, axis))
    s.group(x - 142, 92, 300, 104)
    left, right = x - 64.0, x + 54.0
    for port, to in ((x - 44, left), (x + 34, right)):
        s.line([(port, 76), (port, 100), (to, 100), (to, 110)])
        s.counterbalance(to, 140)
    setting = f"{bar(p.counterbalance_pressure)}\npilot {p.counterbalance_pilot_ratio:.3g} : 1"
    s.text(x + 166, 130, f"counterbalance\nvalves {setting}")
    for to, pilot_from in ((left, right), (right, left)):  # pilots cross below the valves
        level = 206 if to == left else 214
        s.line([(to - 40, 148), (to - 40, level), (pilot_from, level)], pilot=True)
        s.node(pilot_from, level)
    for to, side in ((left, -1), (right, 1)):
        s.line([(to, 170), (to, 226)])
        s.hose(to, 248, _hose_label(p, axis) if side > 0 else "")
        s.line([(to, 270), (to, 384)])
        _relief_pair(s, to, 292, side, bar(p.port_relief_pressure) if side > 0 else "")
    s.line([(left, 384), (left, 394), (x - 9, 394), (x - 9, 404)])
    s.line([(right, 384), (right, 394), (x + 9, 394), (x + 9, 404)])
    _section(s, x, 422, getattr(p, f"{axis}_section_flow"), p.compensator_setting)


def _section(s: Sheet, x: float, y: float, rated: float, setting: float) -> None:
    """Valve with pressure compensator below, P, T and LS."""
    s.four_way(x, y, sensing=True)
    s.text(x + 80, y - 2, f"{flow(rated)}\nat full command")
    s.line([(x - 9, y + 21), (x - 9, y + 40)])
    s.compensator(x - 9, y + 70)
    s.text(x - 62, y + 68, bar(setting), "end")
    s.line([(x + 15, y + 28), (x + 35, y + 28), (x + 35, y + 70)], pilot=True)
    s.line([(x - 9, y + 88), (x - 9, y + 112)])
    s.text(x - 9, y + 126, "P", "middle")
    s.line([(x + 9, y + 21), (x + 9, y + 34), (x + 60, y + 34), (x + 60, y + 112)])
    s.text(x + 60, y + 126, "T", "middle")
    s.node(x + 35, y + 70)
    s.line([(x + 35, y + 70), (x + 35, y + 112)], pilot=True)
    s.text(x + 35, y + 126, "LS", "middle")


def boom_stick_compensated() -> Sheet:
    """Compensated sections with load holding."""
    title = "Boom and stick, variant compensated: compensated sections, load-holding valves, port reliefs"
    s, p = Sheet(1050, 570, title), Numbers("boom_stick", "compensated")
    for axis, x in (("boom", 240.0), ("stick", 750.0)):
        _compensated_drive(s, p, axis, x)
    return s


# ---- swing


def _swing_motor(s: Sheet, p: Numbers, x: float, y: float, brake: bool = False) -> None:
    """Motor with gear; lines A at y - 70 and B at y + 70, drawn to the left."""
    s.motor(x, y)
    s.line([(x, y - 20), (x, y - 70)])
    s.line([(x, y + 20), (x, y + 70)])
    for shift in (-2, 2):
        s.line([(x + 20, y + shift), (x + 78, y + shift)], width=1)
    s.frame(x + 78, y - 14, 34, 28)
    s.text(x + 95, y + 4, f"1 : {p.gear_ratio:.3g}", "middle")
    s.text(x + 118, y - 4, f"{per_revolution(p.motor_displacement)}\nturns the column")
    s.line([(x - 20, y), (x - 34, y), (x - 34, y + 32)], pilot=True)  # case drain
    s.tank(x - 34, y + 40)
    if brake:
        s.brake(x + 48, y)


def _cross(s: Sheet, x: float, top: float, bottom: float, label: str) -> None:
    """Cross-port relief valves between both lines."""
    middle = (top + bottom) / 2
    for k, way in ((0, "down"), (1, "up")):
        c = x + 92 * k
        s.node(c, top)
        s.node(c, bottom)
        s.line([(c, top), (c, middle - 22)])
        s.line([(c, middle + 22), (c, bottom)])
        s.relief(c, middle, way, label if k else "")


def _make_up(s: Sheet, x: float, top: float, bottom: float) -> None:
    """Anti-cavitation valves from the return line to both lines."""
    middle = (top + bottom) / 2
    s.node(x, top)
    s.node(x, bottom)
    s.line([(x, top), (x, middle - 39)])
    s.check(x, middle - 30, "up")
    s.line([(x, middle - 21), (x, middle + 21)])
    s.check(x, middle + 30, "down")
    s.line([(x, middle + 39), (x, bottom)])
    s.node(x, middle)
    s.line([(x, middle), (x - 22, middle), (x - 22, middle + 12)])
    s.tank(x - 22, middle + 20)


def _swing_lines(s: Sheet, x: float, y: float, start: float) -> None:
    """Lines from a valve at (start, y + 140) to the motor at (x, y)."""
    s.line(
        [(x, y - 70), (start - 60, y - 70), (start - 60, y + 92), (start - 9, y + 92), (start - 9, y + 122)]
    )
    s.line([(x, y + 70), (start + 9, y + 70), (start + 9, y + 122)])


def _swing(variant: str, width: float, title: str) -> tuple[Sheet, Numbers]:
    s, p = Sheet(width, 380 if variant == "compensated" else 300, title), Numbers("swing", variant)
    return s, p


def swing() -> Sheet:
    """The paper's circuit."""
    s, p = _swing("lumped", 480, "Swing, variants lumped and quasistatic: valve, lines, motor, gear")
    _swing_motor(s, p, 250, 90)
    _swing_lines(s, 250, 90, 110)
    _valve(s, 110, 230)
    _supply_lines(s, 110, 258, 40)
    return s


def swing_detailed() -> Sheet:
    """With cross-port relief and anti-cavitation valves."""
    title = "Swing, variant detailed: also cross-port relief and anti-cavitation valves"
    s, p = _swing("detailed", 800, title)
    _swing_motor(s, p, 570, 90)
    _swing_lines(s, 570, 90, 110)
    _valve(s, 110, 230)
    _supply_lines(s, 110, 258, 40)
    _cross(s, 250, 20, 160, bar(p.relief_pressure))
    _make_up(s, 480, 20, 160)
    return s


def swing_compensated() -> Sheet:
    """Compensated section with crossover reliefs and brake."""
    title = (
        "Swing, variant compensated: pressure-compensated section, crossover reliefs, make-up, holding brake"
    )
    s, p = _swing("compensated", 800, title)
    _swing_motor(s, p, 570, 90, brake=True)
    _swing_lines(s, 570, 90, 110)
    _section(s, 110, 230, p.swing_section_flow, p.compensator_setting)
    _cross(s, 250, 20, 160, bar(p.relief_pressure))
    _make_up(s, 480, 20, 160)
    return s


CIRCUITS: dict[str, Callable[[], Sheet]] = {
    "supply_ideal": supply_ideal,
    "supply_engine_pump": supply_engine_pump,
    "supply_load_sensing": supply_load_sensing,
    "boom_stick": boom_stick,
    "boom_stick_detailed": boom_stick_detailed,
    "boom_stick_compensated": boom_stick_compensated,
    "swing": swing,
    "swing_detailed": swing_detailed,
    "swing_compensated": swing_compensated,
}


def main() -> None:
    """Write the pictures."""
    for name, draw in CIRCUITS.items():
        (IMAGES / f"circuit_{name}.svg").write_text(draw().svg(), encoding="utf-8")


if __name__ == "__main__":
    main()
