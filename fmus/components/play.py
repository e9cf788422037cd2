"""Play: hysteresis between a command and the spool that follows it.

    dz/dt = k (r(u - z - h + w/2) - r(z - u - h + w/2))        r the `ramp` of width w

z follows the input u at a distance of h and rests while |u - z| < h - w/2. In slow motion the loop of z over
u is 2 h wide, in very slow motion 2 h - w. At a rate of c the distance is h + c/k: the play has the lag 1/k.
With h = 0 the two ramps add up to a straight line, dz/dt = k (u - z) exactly. The rate of u is not needed,
and there is no event.

Reference: the play operator of M. A. Krasnosel'skii and A. V. Pokrovskii, Systems with Hysteresis, Springer
1989, with a lag and rounded.
"""

from fmus.contract import Scalar
from fmus.smooth import ramp


def play_rate(u: Scalar, z: Scalar, half_width: Scalar, rate: Scalar, rounding: Scalar) -> Scalar:
    """dz/dt [1/s of u] of the equation above: h `half_width`, k `rate` [1/s], w `rounding`."""
    ahead, rest = u - z, half_width - rounding / 2
    return rate * (ramp(ahead - rest, rounding) - ramp(-ahead - rest, rounding))
