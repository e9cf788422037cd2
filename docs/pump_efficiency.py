"""Draws docs/images/pump-efficiency.png and prints its numbers: `python docs/pump_efficiency.py`.

Overall efficiency of a pump of `engine_pump` over pressure and stroke, and of a measured pump scaled to the
same displacement: variable axial piston pump of 107 cm3/rev, Pourmovahed, Beachley and Fronczak 1992. Their
loss coefficients are those of Wilson and Schloesser, with compressibility and friction by speed:

    Q_loss = D C_s dp/mu + x D w dp/beta
    T_loss = D C_v mu w + C_f D dp + x C_h rho w^2 D^(5/3)/2
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.components import engine_and_pump, oil
from fmus.machine.parts import FAMILIES
from fmus.parameters import parameters, values
from orchestrator.pages.figures import PALETTE
from orchestrator.pages.plotting import heading, new_figure, png, style_axes

IMAGE = Path(__file__).parent / "images" / "pump-efficiency.png"
SUPPLY = FAMILIES["supply"]["engine_pump"]
P = values(SUPPLY).p
DRIVES = values(FAMILIES["swing"]["detailed"]).p  # with the numbers of the oil
SPEED = P["engine_rated_speed"]
SLIP, DRAG, FRICTION, SPEED_FRICTION = 4.26e-9, 23.5e3, 53.7e-3, 53.6  # C_s, C_v, C_f, C_h
Array = NDArray[np.float64]


def ours(rise: Array, stroke: Array, celsius: float = 60.0) -> Array:
    """Overall efficiency of a pump of the supply at its rated speed."""
    pump = engine_and_pump.at_viscosity(
        parameters(SUPPLY).pumps["pump_1"], float(oil.viscosity_ratio(celsius + 273.15))
    )
    flow = engine_and_pump.suction_flow(pump, stroke, SPEED) - pump.leakage * rise
    friction = np.array([float(engine_and_pump.pump_friction(pump, SPEED, p)) for p in rise.ravel()])
    torque = stroke * pump.displacement * rise + friction.reshape(rise.shape)
    return np.asarray(np.maximum(flow, 0.0) * rise / (torque * SPEED))


def measured(rise: Array, stroke: Array, celsius: float = 60.0) -> Array:
    """Overall efficiency of the measured pump, scaled."""
    d, density = P["pump_displacement"], DRIVES["density"]
    viscosity = DRIVES["viscosity"] * float(oil.viscosity_ratio(celsius + 273.15))
    flow = stroke * d * SPEED * (1 - rise / DRIVES["bulk_modulus"]) - d * SLIP * rise / viscosity
    drag = d * DRAG * viscosity * SPEED + stroke * SPEED_FRICTION * density * SPEED**2 * d ** (5 / 3) / 2
    torque = d * rise * (stroke + FRICTION) + drag
    return np.maximum(flow, 0.0) * rise / (torque * SPEED)


def main() -> None:
    """Draw, and print the efficiencies at some points."""
    rise, stroke = np.meshgrid(np.linspace(1e6, 21e6, 60), np.linspace(0.05, 1.0, 60))
    figure = new_figure(9.6, 4.0)
    levels = (0.5, 0.6, 0.7, 0.8, 0.85, 0.88, 0.9)
    for axes, title, map_of in zip(
        figure.subplots(1, 2, sharey=True), ("model", "measured pump"), (ours, measured), strict=True
    ):
        lines = axes.contour(rise / 1e5, stroke, map_of(rise, stroke), levels, colors=[PALETTE.colour(0)])
        axes.clabel(lines, fmt="%.2f")
        style_axes(axes, f"{title}: pressure [bar]", "stroke [1]")
    heading(
        figure, "", "overall efficiency at 2500 rpm and 60 °C · measured: Pourmovahed et al. 1992, scaled"
    )
    IMAGE.write_bytes(png(figure))
    for celsius, bar, share in (
        (60, 207, 1.0),
        (60, 100, 1.0),
        (60, 207, 0.5),
        (60, 207, 0.2),
        (20, 207, 1.0),
    ):
        point = (np.array([bar * 1e5]), np.array([share]), celsius)
        print(
            f"{celsius} degC, {bar} bar, stroke {share:g}:"
            f" model {ours(*point)[0]:.3f}, measured {measured(*point)[0]:.3f}"
        )


if __name__ == "__main__":
    main()
