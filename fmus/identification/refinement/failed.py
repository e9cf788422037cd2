"""A simulation that did not reach its end."""

from __future__ import annotations


class Failed(Exception):
    """The model could not be simulated: why, and the time [s] it reached."""

    def __init__(self, why: str, time: float) -> None:
        super().__init__(f"{why} at t = {time:.9g} s")
        self.why, self.time = why, time
