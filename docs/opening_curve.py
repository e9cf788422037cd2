"""Draws docs/images/opening-curve.png and prints its numbers: `python docs/opening_curve.py`.

The opening curve of a forwarder loader's valve as a table of an edge, behind the dead band of this machine:
opening, and C_R over the command as in Fig. 5 of the paper, with polynomials as the paper fits one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from fmus.components import orifice, spool_valve
from fmus.components.opening_curve import CURVE, POINTS, OpeningTable, pieces
from fmus.parameters import values
from fmus.swing import SWING
from orchestrator.pages.figures import PALETTE
from orchestrator.pages.plotting import heading, legend, new_figure, png, style_axes

IMAGE = Path(__file__).parent / "images" / "opening-curve.png"
P = values(SWING).p
# relative area over the stroke behind the overlap, forwarder loader, Ganguly and Le Duc 2017
LOADER = ((0.0, 0.0), (0.1, 0.021), (0.2, 0.044), (0.3, 0.071), (0.4, 0.1), (0.5, 0.15), (1.0, 1.0))
BLIND = 1.0  # V: up to it the paper's flow sensor shows nothing
DEGREE = 8
Array = NDArray[np.float64]


def table() -> list[tuple[float, float]]:
    """Points (command [V], opening [1]) behind the dead band."""
    band, full = P["valve_dead_band"], P["valve_full_command"]
    return [(round(band + (full - band) * stroke, 3), opening) for stroke, opening in LOADER]


def opening(points: list[tuple[float, float]], volts: Array) -> Array:
    """Opening [1] by the table."""
    rows = [*points, *[(0.0, 0.0)] * (POINTS - len(points))]
    entries = {f"command_{i}": v for i, (v, _) in enumerate(rows, 1)}
    entries |= {f"opening_{i}": a for i, (_, a) in enumerate(rows, 1)}
    coefficients = pieces(OpeningTable(**entries)).coefficients
    return np.array(CURVE.map(len(volts))(volts[None, :], coefficients)).ravel()


def straight(volts: Array) -> Array:
    """Opening [1] of the line."""
    shape = (P["valve_dead_band"], P["valve_full_command"], P["valve_command_rounding"])
    return np.array([float(spool_valve.opening(v, *shape)) for v in volts])


def resistance(share: Array) -> Array:
    """C_R [Pa.s2/m6], eq. (2)."""
    gain = float(orifice.flow_gain(P["valve_area"], P["valve_discharge_coefficient"], P["density"]))
    return 1 / (gain * share) ** 2


def main() -> None:
    """Draw, and print table and errors of the polynomials."""
    points, volts = table(), np.linspace(0.0, 10.0, 1001)
    share, seen = opening(points, volts), volts >= BLIND
    measured = volts[seen][::25]
    truth = resistance(opening(points, measured))
    plain = Polynomial.fit(measured, truth, DEGREE)
    logarithmic = Polynomial.fit(measured, np.log(truth), DEGREE)
    figure = new_figure(9.6, 4.0)
    left, right = figure.subplots(1, 2)
    left.plot(volts, straight(volts), color=PALETTE.faint, label="line with dead band")
    left.plot(volts, share, color=PALETTE.colour(0), label="table")
    left.plot(*np.array(points).T, "o", color=PALETTE.colour(0), markersize=4, label="its points")
    style_axes(left, "command [V]", "opening [1]")
    right.semilogy(volts[seen], resistance(straight(volts[seen])), color=PALETTE.faint, label="line")
    right.semilogy(volts[seen], resistance(share[seen]), color=PALETTE.colour(0), label="table")
    fits = {f"polynomial of degree {DEGREE}": plain(volts), f"ln C_R of degree {DEGREE}": None}
    fits[f"ln C_R of degree {DEGREE}"] = np.exp(logarithmic(volts))
    for index, (name, fit) in enumerate(fits.items(), 1):
        shown = np.where(seen & (fit > 0), fit, np.nan)
        right.semilogy(volts, shown, "--", color=PALETTE.colour(index), linewidth=1.2, label=name)
    right.axvspan(0.0, BLIND, color=PALETTE.grid, label="blind flow sensor")
    right.set_xlim(0.0, 10.0)
    style_axes(right, "command [V]", "C_R [Pa·s²/m⁶]")
    for axes in (left, right):
        legend(axes, ncols=2)
    heading(
        figure, "", "opening of a forwarder loader (Ganguly and Le Duc 2017), not FERIC data · cf. Fig. 5"
    )
    IMAGE.write_bytes(png(figure))
    print("points:", ", ".join(f"({v:g} V, {a:g})" for v, a in points))
    for name, fit in fits.items():
        ratio = fit[seen] / resistance(share[seen])
        negative = np.mean(fit[seen] <= 0)
        print(
            f"{name}: C_R by {ratio.min():.3g} to {ratio.max():.3g} of the table's, {negative:.0%} negative"
        )


if __name__ == "__main__":
    main()
