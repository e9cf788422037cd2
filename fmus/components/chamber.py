"""Pressure of a volume of oil: capacitance, entrained air, and cavitation.

    dP/dt = net inflow / (C + C_c(P))                   eq. (9a)

The paper's capacitance C = V / beta is valid above the vapour pressure.

**Cavitation.** Below the vapour pressure P_v a cavity grows at nearly constant pressure. It is modelled as a
capacitance

    C_c(P) = C_ref exp((P_v - P) / dP)          volume of the cavity = dP C_c(P)

which conserves oil: the oil that left the chamber has to return before the pressure rises. With C_ref = 1e-12
m3/Pa, P_v = -20 kPa, dP = 5 kPa (gauge) the pressure is -81 kPa at a cavity of 1 litre, and 50 kPa above P_v
the cavity is 2e-13 m3. This smooth law is an assumption for vapour and released air, not a bubble model.
Valid down to 0.2 MPa below P_v, where the exponent is limited.

**Entrained air** gives a compliance that falls with the pressure:

    kappa(P) = 1/beta + a/(n p) (p_0/p)^(1/n)        p = P + p_0 absolute        beta_eff = 1/kappa

a is the volume of free air at atmospheric pressure p_0 per volume of oil, n its polytropic exponent: 1 for
slow changes, 1.4 for fast ones. The compliances of oil and air are added (H. E. Merritt, Hydraulic Control
Systems, 1967, chapter 2); dissolved air is neglected. The exact law divides by the volume of the mixture at P
and has no energy in closed form. For 1 % of air kappa differs from it by 0.3 % above 10 bar, and by 1 %,
which is a, at atmospheric pressure. Below `FLOOR` the law is continued as its tangent, so that the result is
finite for a trial pressure below vacuum; the cavity dominates there.

The energy of a volume V at P is V e(P), e(P) = int_0^P P' kappa(P') dP'.
"""

from dataclasses import replace

import casadi as ca

from fmus.components import oil
from fmus.contract import Group, Quantity, Scalar

# C_ref [m3/Pa], similar to the capacitance of a 4 m hose, so the cavity matters from P_v on
CAVITY_CAPACITANCE = 1e-12
VAPOUR_PRESSURE = -20e3  # P_v [Pa] gauge
CAVITY_SCALE = 5e3  # dP [Pa]
_LARGEST_EXPONENT = 40.0  # a cavity of 1e9 m3; keeps trial steps of a solver finite
_SMALLEST_EXPONENT = -60.0  # 1e-26 of C_ref; keeps exp() out of the slow denormal numbers

RATED_PRESSURE = 35e6  # Pa, of mobile valves, cylinders and hoses of the class; above it an FMU warns
ATMOSPHERE = 101325.0  # p_0 [Pa], standard; a pressure below vacuum, -p_0, does not exist
OVERLOAD = "the pressure exceeds the rating of valves, cylinders and hoses: relief valves would limit it"
VACUUM = "the pressure falls below vacuum: no oil does that"
FLOOR = 20e3  # absolute pressure [Pa] down to which the polytropic law is used; 80 kPa below tank


def pressure(text: str) -> Quantity:
    """Declaration of an oil pressure as a state: nominal 10 MPa, with a smaller absolute tolerance.

    During cavitation errors must be small compared with dP. After strokes of 1 to 6 V, some with cavitation,
    the error of the pressures is 0.004 % of their range at a tolerance of 1e-6. With the absolute tolerance
    from the nominal value it would be 0.35 % at the same cost.

    Only variants with relief valves limit it; if it is also an output, the FMU warns above RATED_PRESSURE.
    Cavitation is reported by its volume (`cavity`).
    """
    return replace(port_pressure(text), absolute=1e5, warn_below=-ATMOSPHERE, below=VACUUM)


def port_pressure(text: str) -> Quantity:
    """Declaration of the pressure at a node without volume, as an output: nothing there can cavitate.

    Below the vapour pressure the oil of its line would tear off, which the model of the node leaves out.
    """
    known = Quantity("Pa", text, 1e7, warn_above=RATED_PRESSURE, warn_below=VAPOUR_PRESSURE)
    return replace(known, meaning=OVERLOAD, below="the oil column tears off")


def cavity(text: str) -> Quantity:
    """Declaration of the volume of cavities as an output, with a warning if the oil cavitates."""
    return Quantity(
        "m3",
        f"Volume of cavities in {text}: above 1e-7 the oil cavitates",
        1e-6,
        warn_above=1e-7,
        meaning=f"cavitation in {text}",
    )


def cavity_capacitance(pressure: Scalar) -> Scalar:
    """C_c(P) [m3/Pa]."""
    exponent = (VAPOUR_PRESSURE - pressure) * (1 / CAVITY_SCALE)
    return CAVITY_CAPACITANCE * ca.exp(ca.fmax(_SMALLEST_EXPONENT, ca.fmin(exponent, _LARGEST_EXPONENT)))


def cavity_volume(pressure: Scalar) -> Scalar:
    """Volume of the cavity [m3]: the integral of C_c from P up."""
    return CAVITY_SCALE * cavity_capacitance(pressure)


def pressure_rate(pressure: Scalar, net_flow: Scalar, capacitance: Scalar, fraction: float = 1.0) -> Scalar:
    """dP/dt [Pa/s] = net inflow / (C + C_c(P)), eq. (9a); a lump has a `fraction` of the line's C_c."""
    return net_flow / (capacitance + fraction * cavity_capacitance(pressure))


def stored_energy(pressure: Scalar, capacitance: Scalar) -> Scalar:
    """Energy [J], the integral of P (C + C_c(P)) dP from 0; the integral of C_c starts at high pressure."""
    return capacitance * pressure**2 / 2 - cavity_volume(pressure) * (pressure + CAVITY_SCALE)


class Density(Group):
    """Density of the oil."""

    density: Scalar = Quantity(
        "kg/m3", "Density of the oil", 1e3, minimum=100.0, group="Oil", warmed=oil.DENSITY
    )


class BulkModulus(Group):
    """Bulk modulus of the oil."""

    bulk_modulus: Scalar = Quantity(
        "Pa", "Bulk modulus of the oil", 1e9, minimum=1e7, group="Oil", warmed=oil.BULK
    )


class Liquid(Density):
    """Density and viscosity of the oil."""

    viscosity: Scalar = Quantity(
        "Pa.s",
        "Dynamic viscosity at 60 degC of an oil ISO VG 46, with which all parameters are given",
        1e-2,
        minimum=1e-7,
        group="Oil",
        warmed=oil.LAMINAR,
    )

    @property
    def kinematic_viscosity(self) -> Scalar:
        """nu [m2/s]."""
        return self.viscosity / self.density


class Oil(oil.Grade, BulkModulus, Liquid):
    """Parameters of the oil."""

    def compliance(self, _pressure: Scalar) -> Scalar:
        """kappa [1/Pa] at a gauge pressure."""
        return 1 / self.bulk_modulus

    def energy_density(self, pressure: Scalar) -> Scalar:
        """e [J/m3] at a gauge pressure."""
        return pressure**2 / (2 * self.bulk_modulus)


class AeratedOil(Oil):
    """Parameters of the oil with entrained air."""

    air_share: Scalar = Quantity(
        "1", "Volume of free air at atmospheric pressure per volume of oil", 1e-2, minimum=0.0, maximum=0.2
    )
    air_exponent: Scalar = Quantity("1", "Polytropic exponent of the air", minimum=1.01, maximum=1.7)

    def compliance(self, pressure: Scalar) -> Scalar:
        """kappa [1/Pa] at a gauge pressure."""
        return super().compliance(pressure) + air_compliance(self, pressure)

    def energy_density(self, pressure: Scalar) -> Scalar:
        """e [J/m3] at a gauge pressure."""
        return super().energy_density(pressure) + air_energy_density(self, pressure)


class Air(AeratedOil):
    """The air in a volume whose capacitance already contains the oil."""

    def compliance(self, pressure: Scalar) -> Scalar:
        """kappa - 1/beta [1/Pa] at a gauge pressure."""
        return air_compliance(self, pressure)

    def energy_density(self, pressure: Scalar) -> Scalar:
        """e - P^2/(2 beta) [J/m3] at a gauge pressure."""
        return air_energy_density(self, pressure)


def _floored(pressure: Scalar) -> tuple[Scalar, Scalar]:
    """Absolute pressure [Pa], at least FLOOR, and its depth [Pa] below FLOOR."""
    absolute = pressure + ATMOSPHERE
    return ca.fmax(absolute, FLOOR), ca.fmax(FLOOR - absolute, 0)


def _air(fluid: AeratedOil, absolute: Scalar) -> tuple[Scalar, Scalar]:
    """Volume [1] of the air per volume of oil, and its compliance [1/Pa]; exp() is its own derivative."""
    s = 1 / fluid.air_exponent
    volume = fluid.air_share * ca.exp(s * ca.log(ATMOSPHERE / absolute))
    return volume, s * volume / absolute


def air_compliance(fluid: AeratedOil, pressure: Scalar) -> Scalar:
    """kappa - 1/beta [1/Pa] at a gauge pressure."""
    absolute, depth = _floored(pressure)
    _, air = _air(fluid, absolute)
    return air * (1 + (1 + 1 / fluid.air_exponent) * depth / absolute)


def air_energy_density(fluid: AeratedOil, pressure: Scalar) -> Scalar:
    """e - P^2/(2 beta) [J/m3], the energy of the air per volume of oil at a gauge pressure."""
    s, (absolute, d) = 1 / fluid.air_exponent, _floored(pressure)
    volume, air = _air(fluid, absolute)
    polytropic = s * (absolute * volume / (1 - s) + ATMOSPHERE * volume / s)
    at_zero = fluid.air_share * ATMOSPHERE * (s / (1 - s) + 1)
    gauge, c = absolute - ATMOSPHERE, (1 + s) / absolute  # kappa of the tangent: air (1 + c depth)
    tangent = air * (gauge * d + (gauge * c - 1) * d**2 / 2 - c * d**3 / 3)
    return polytropic - at_zero - tangent
