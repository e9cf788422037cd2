"""How many messages a connection may send: a bucket that fills at a steady rate."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Bucket:
    """`rate` messages per second in the long run [1/s], `depth` at once.

    An honest browser sends 33 per second; those that a slow network held up may come in a bunch.
    """

    rate: float = 100.0
    depth: float = 30.0
    content: float = 30.0
    when: float = 0.0

    def take(self, now: float) -> bool:
        """Whether one more message is allowed at the time `now` [s] of a clock that never goes back."""
        self.content = min(self.depth, self.content + self.rate * max(0.0, now - self.when))
        self.when = now
        if self.content < 1:
            return False
        self.content -= 1
        return True
