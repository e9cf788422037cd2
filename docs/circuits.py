"""Draws the diagrams of docs/machine.md, with parameters, and its graphs: `python docs/circuits.py`."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from pathlib import Path

from hydraulic_symbols import Sheet

from fmus.export.graph import graphs
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


def _return_line(s: Sheet, x: float, preload: float) -> None:
    s.text(x, 122, "T", "middle")
    s.line([(x, 128), (x, 155)])
    s.check(x, 164, "down")
    s.text(x + 14, 168, bar(preload))
    s.line([(x, 173), (x, 200)])
    s.tank(x, 208)


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
        s.line([(x, 150), (x + 38, 150), (x + 38, 197), (x + 23, 197)], pilot=True)
        s.text(x + 42, 168, f"compensator\n{bar(setting)}")
    s.line([(160, 70), (580, 70)])
    s.node(300, 70)
    s.text(588, 74, "P")
    _main_relief(s, 450, f"main relief\n{bar(p.relief_pressure)}")
    _return_line(s, 580, p.return_preload)
    return s


def supply_load_sensing() -> Sheet:
    """Load-sensing pump."""
    p = Numbers("supply", "load_sensing")
    title = "Supply, variant load_sensing: a variable pump that holds a margin over the highest load"
    s = Sheet(760, 310, title)
    _engine(s, 60, 220, 160, p.engine_rated_speed, p.engine_rated_speed * p.engine_rated_torque)
    _pump_line(s, 180, per_revolution(p.main_pump_displacement))
    limits = (
        f"margin {bar(p.margin)}\ncut-off {bar(p.pressure_cut_off)}\ntorque limit {p.torque_limit:.0f} N.m"
    )
    s.frame(246, 130, 126, 56)
    s.text(309, 148, limits, "middle")
    s.node(180, 150)
    s.line([(180, 150), (246, 150)], pilot=True)
    s.line([(270, 186), (270, 197), (203, 197)], pilot=True)
    s.line([(180, 70), (690, 70)])
    s.text(698, 74, "P")
    s.shuttle(560, 34)
    for y, text in ((20, "LS swing"), (48, "LS boom and stick")):
        s.line([(560, y), (640, y)], pilot=True)
        s.text(648, y + 4, text)
    s.line([(552, 34), (390, 34), (390, 160), (372, 160)], pilot=True)
    s.text(398, 26, f"LS line, lag {p.load_sensing_lag * 1e3:.0f} ms")
    s.node(444, 34)
    s.line([(444, 34), (444, 128)], pilot=True)
    s.relief(444, 150, label=f"LS relief\n{bar(p.pressure_cut_off - p.load_sensing_relief_difference)}")
    s.line([(444, 172), (444, 200)], pilot=True)
    s.tank(444, 208)
    _main_relief(s, 570, f"main relief\n{bar(p.relief_pressure)}")
    _return_line(s, 690, p.return_preload)
    return s


# ---- boom and stick


def _valve(s: Sheet, x: float, y: float) -> None:
    s.four_way(x, y)
    s.line([(x - 9, y + 21), (x - 9, y + 40)])
    s.line([(x + 9, y + 21), (x + 9, y + 40)])


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
    s.line([(x - 44, 166), (x - 9, 166), (x - 9, 190)])
    s.line([(x + 34, 166), (x + 9, 166), (x + 9, 190)])
    _valve(s, x, 208)
    _supply_lines(s, x, 248, 40)


def boom_stick() -> Sheet:
    """The paper's circuit."""
    title = "Boom and stick, variants lumped and quasistatic: valve, hoses, cylinder"
    return _pair(Sheet(640, 300, title), Numbers("boom_stick", "lumped"), _drive)


def _relief_pair(s: Sheet, port: float, y: float, side: int, label: str) -> None:
    """Relief and anti-cavitation valve of a port to the tank, beside the line."""
    x = port + side * 62
    s.node(port, y)
    s.line([(port, y), (x, y), (x, y + 8)])
    s.relief(x, y + 30, label=label if side > 0 else "")
    if side < 0:
        s.text(x - 30, y + 34, label, "end")
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
        _relief_pair(s, port, 98, side, bar(p.relief_pressure))
        s.hose(port, 220, _hose_label(p, axis) if side > 0 else "")
        s.line([(port, 242), (port, 256)])
    s.line([(x - 44, 256), (x - 9, 256), (x - 9, 284)])
    s.line([(x + 34, 256), (x + 9, 256), (x + 9, 284)])
    _valve(s, x, 302)
    s.text(x + 80, 296, f"spool {p.spool_frequency:.0f} Hz,\ndamping {p.spool_damping:.2g}")
    _supply_lines(s, x, 342, 40)


def boom_stick_detailed() -> Sheet:
    """With relief and anti-cavitation valves at the cylinder."""
    title = "Boom and stick, variant detailed: also relief and anti-cavitation valves at each cylinder port"
    s, p = Sheet(970, 400, title), Numbers("boom_stick", "detailed")
    for axis, x in (("boom", 240.0), ("stick", 720.0)):
        _detailed_drive(s, p, axis, x)
    return s


def _compensated_drive(s: Sheet, p: Numbers, axis: str, x: float) -> None:
    s.cylinder(x, 60, _cylinder_label(p, axis))
    s.group(x - 142, 92, 310, 146)
    left, right = x - 64.0, x + 54.0
    for port, to in ((x - 44, left), (x + 34, right)):
        s.line([(port, 76), (port, 100), (to, 100), (to, 110)])
        s.counterbalance(to, 140)
    ratios = f"{p.boom_head_pilot_ratio:.3g} : 1\nat boom head,\nelse {p.boom_rod_pilot_ratio:.3g} : 1"
    setting = f"valves {bar(p.counterbalance_pressure)}\npilot ratio {ratios}"
    s.text(x + 174, 130, f"counterbalance\n{setting}\nspring chamber\ndrained")
    for to, pilot_from in ((left, right), (right, left)):  # pilots cross below the valves
        level = 208 if to == left else 220
        s.line([(to - 40, 148), (to - 40, level), (pilot_from, level)], pilot=True)
        s.node(pilot_from, level)
    for to, side in ((left, -1), (right, 1)):
        s.line([(to, 186), (to, 248)])
        s.hose(to, 270, _hose_label(p, axis) if side > 0 else "")
        s.line([(to, 292), (to, 402)])
        _relief_pair(s, to, 314, side, bar(p.port_relief_pressure))
    s.line([(left, 402), (x - 9, 402), (x - 9, 426)])
    s.line([(right, 402), (x + 9, 402), (x + 9, 426)])
    _section(s, x, 444, getattr(p, f"{axis}_section_flow"), p, bleeding=True)


def _section(s: Sheet, x: float, y: float, rated: float, p: Numbers, bleeding: bool = False) -> None:
    """Valve with pressure compensator and check valve below: P, T, and LS that ends at (x + 35, y + 124)."""
    s.four_way(x, y, sensing=True, bleeding=bleeding)
    s.text(x + 82, y - 2, f"{flow(rated)}\nat full command")
    s.line([(x - 9, y + 21), (x - 9, y + 40)])
    s.compensator(x - 9, y + 70)
    saturated = f"saturated: {p.compensator_sharing:.3g} (P - LS)"
    s.text(x - 42, y + 68, f"compensator\n{bar(p.compensator_setting)},\n{saturated}", "end")
    s.line([(x + 15, y + 28), (x + 35, y + 28), (x + 35, y + 70)], pilot=True)
    s.check(x - 9, y + 97, "up")
    s.line([(x - 9, y + 106), (x - 9, y + 124)])
    s.text(x - 9, y + 138, "P", "middle")
    s.line([(x + 9, y + 21), (x + 9, y + 34), (x + 60, y + 34), (x + 60, y + 124)])
    s.text(x + 60, y + 138, "T", "middle")
    s.node(x + 35, y + 70)
    s.line([(x + 35, y + 70), (x + 35, y + 124)], pilot=True)


def boom_stick_compensated() -> Sheet:
    """Compensated sections with load holding."""
    title = "Boom and stick, variant compensated: compensated sections, load-holding valves, port reliefs"
    s, p = Sheet(1090, 660, title), Numbers("boom_stick", "compensated")
    for axis, x in (("boom", 240.0), ("stick", 760.0)):
        _compensated_drive(s, p, axis, x)
    s.shuttle(530, 610)
    for x, y in ((275, 624), (795, 596)):
        s.line([(x, 568), (x, y), (530, y)], pilot=True)
    s.line([(522, 610), (490, 610)], pilot=True)
    s.text(482, 614, "LS", "end")
    return s


# ---- swing


def _swing_motor(s: Sheet, p: Numbers, x: float, y: float, brake: bool = False) -> None:
    """Motor with gear; lines A at y - 70 and B at y + 70, drawn to the left."""
    s.motor(x, y)
    s.line([(x, y - 20), (x, y - 70)])
    s.line([(x, y + 20), (x, y + 70)])
    s.text(x + 20, y - 22, per_revolution(p.motor_displacement))
    end = x + (190 if brake else 146)
    for shift in (-2, 2):
        s.line([(x + 20, y + shift), (x + 54, y + shift)], width=1)
        s.line([(x + 98, y + shift), (end, y + shift)], width=1)
    s.frame(x + 54, y - 14, 44, 28)
    s.text(x + 76, y + 4, f"{p.gear_ratio:.3g} : 1", "middle")
    s.text(end + 6, y + 4, "column")
    s.line([(x - 20, y), (x - 34, y), (x - 34, y + 32)], pilot=True)  # case drain
    s.tank(x - 34, y + 40)
    if brake:
        s.brake(x + 144, y)
        s.text(x + 162, y + 26, f"holding brake\n{p.brake_torque / 1e3:.0f} kN.m")
        s.line([(x + 120, y + 24), (x + 110, y + 24), (x + 110, y + 58)], pilot=True)
        s.text(x + 106, y + 72, f"P while commanded,\nat least {bar(p.brake_release_pressure)}")


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


def swing() -> Sheet:
    """The paper's circuit."""
    title = "Swing, variants lumped and quasistatic: valve, lines, motor, gear"
    s, p = Sheet(480, 320, title), Numbers("swing", "lumped")
    _swing_motor(s, p, 250, 90)
    _swing_lines(s, 250, 90, 110)
    _valve(s, 110, 230)
    _supply_lines(s, 110, 270, 40)
    return s


def swing_detailed() -> Sheet:
    """With crossover relief and anti-cavitation valves."""
    title = "Swing, variant detailed: also crossover relief and anti-cavitation valves"
    s, p = Sheet(800, 320, title), Numbers("swing", "detailed")
    _swing_motor(s, p, 590, 90)
    _swing_lines(s, 590, 90, 110)
    _valve(s, 110, 230)
    s.text(190, 224, f"spool {p.spool_frequency:.0f} Hz,\ndamping {p.spool_damping:.2g}")
    _supply_lines(s, 110, 270, 40)
    _cross(s, 250, 20, 160, f"crossover\n{bar(p.relief_pressure)}")
    _make_up(s, 500, 20, 160)
    return s


def swing_compensated() -> Sheet:
    """Compensated section with crossover reliefs and brake."""
    title = (
        "Swing, variant compensated: pressure-compensated section, crossover reliefs, make-up, holding brake"
    )
    s, p = Sheet(940, 390, title), Numbers("swing", "compensated")
    _swing_motor(s, p, 660, 90, brake=True)
    _swing_lines(s, 660, 90, 220)
    _section(s, 220, 230, p.swing_section_flow, p)
    s.text(255, 368, "LS", "middle")
    _cross(s, 340, 20, 160, f"crossover\n{bar(p.relief_pressure)}")
    _make_up(s, 570, 20, 160)
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


def pictures() -> dict[str, str]:
    """All pictures by file name: diagrams, and the graphs of each variant."""
    drawn = {f"circuit_{name}.svg": draw().svg() for name, draw in CIRCUITS.items()}
    for variants in FAMILIES.values():
        for variant, sub in variants.items():
            drawn |= {f"graph_{axis}_{variant}.svg": graph for axis, graph in graphs(sub).items()}
    return drawn


def main() -> None:
    """Write the pictures."""
    for name, drawn in pictures().items():
        (IMAGES / name).write_text(drawn, encoding="utf-8")


if __name__ == "__main__":
    main()
