"""Compensation of the play between command and spool (`fmus.components.play`), whose width is learned.

    u = w + m b (1 - w^2/U^2) s        s = d/sqrt(d^2 + (n/3)^2),  d = w - t,  t' = play of w, half width n
    b' = f/(1 + (f/f_0)^2)    f = g e (U - D)/W v^2/(v^2 + v_0^2) a/sqrt(a^2 + a_0^2)    b >= 0 and bounded

The factor 1 - w^2/U^2 keeps u within full command; near it less than the play is compensated, 84 % of b at
4 V of 10, 36 % at 8 V.

w is the command that the spool is to follow, u the command, m the weight of coordinated control, U full
command and D the dead band. s tells from which side w was moved last: a reversal by more than n, `reversal`,
moves u by 2 b, which carries the pilot head through the play. w is behind the amplifier, so u and the valve
see the same reversals; before it s would also follow oscillations that the amplifier suppresses, and would no
longer tell where the spool is.

b is the half width, at the start that of `hysteresis`. It integrates the position error e as a voltage, while
the reference has an acceleration a: what is short of the play leaves the spool behind in the direction of a.
An error of the feedforward has the sign of the speed v instead, so it raises b while the speed rises and
lowers it while the speed falls. The direction of w itself would not do: it follows oscillations, whose lag
looks like a play, and what is learned from them sustains them. Errors beyond what a play causes teach little.
"""

from dataclasses import dataclass

import casadi as ca

from fmus.components.play import play_rate
from fmus.contract import Scalar
from fmus.smooth import ramp

TRAILING_RATE = 200.0  # 1/s: far faster than the amplifier, so that t is a play of w without lag

LARGEST_LESSON = 0.3  # V/s: a usual half width in a second; faster errors come from lag, jumps and stops


@dataclass(frozen=True)
class Compensation:
    """One valve: w, t and b [V], m [1], full command U and `reversal` n [V]."""

    spool: Scalar
    trailing: Scalar
    half_width: Scalar
    weight: Scalar
    full_command: Scalar
    reversal: Scalar

    @property
    def _distance(self) -> Scalar:
        return ca.sqrt((self.spool - self.trailing) ** 2 + (self.reversal / 3) ** 2)

    @property
    def side(self) -> Scalar:
        """s [1]: above 0 if the spool is to move in the positive direction."""
        return (self.spool - self.trailing) / self._distance

    @property
    def trailing_rate(self) -> Scalar:
        """t' [V/s]."""
        return play_rate(self.spool, self.trailing, self.reversal, TRAILING_RATE, self.reversal / 3)

    @property
    def _room(self) -> Scalar:
        return 1 - (self.spool / self.full_command) ** 2

    @property
    def command(self) -> Scalar:
        """u [V]; not beyond full command."""
        return self.spool + self.weight * self.half_width * self._room * self.side

    def command_rate(self, spool_rate: Scalar, half_width_rate: Scalar, weight_rate: Scalar) -> Scalar:
        """u' [V/s], exact."""
        side_rate = (1 - self.side**2) / self._distance * (spool_rate - self.trailing_rate)
        room_rate = -2 * self.spool * spool_rate / self.full_command**2
        size = self.weight * self.half_width
        size_rate = weight_rate * self.half_width + self.weight * half_width_rate
        moved = size_rate * self._room * self.side + size * room_rate * self.side
        return spool_rate + moved + size * self._room * side_rate


def learned_rate(f: Scalar) -> Scalar:
    """b' [V/s], without the bounds of b."""
    return f / (1 + (f / LARGEST_LESSON) ** 2)


def beyond_limits(half_width: Scalar, limit: Scalar) -> Scalar:
    """How far [V] a half width is beyond 0 ... limit."""
    return ramp(half_width - limit, limit / 10) - ramp(-half_width, limit / 10)
