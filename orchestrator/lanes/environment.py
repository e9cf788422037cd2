"""A vector environment of Gymnasium: many machines that learn to be driven, in the lanes of all cores.

from orchestrator.lanes.environment import MachinesEnv

def reward(signals, commands):
    return signals[:, 0]  # how high the tip is [m]

env = MachinesEnv(
    "build/harvester.ssp",
    num_envs=64,
    commands={"boom_command": (-10, 10), "stick_command": (-10, 10)},  # [V]
    signals=["manipulator.tip_height", "manipulator.boom_angle", "manipulator.stick_angle"],
    reward=reward,
    starts={"manipulator.initial_boom_angle": (0.3, 0.6)},  # [rad], drawn for each episode
)
signals, _ = env.reset(seed=1)
for _ in range(100):
    signals, rewards, terminated, truncated, infos = env.step(env.action_space.sample())
env.close()
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.lanes.machines import Machines
from orchestrator.ssp.system import System

require("learn", "the environment")

from gymnasium.spaces import Box  # noqa: E402  after the message on a missing package
from gymnasium.vector import AutoresetMode, VectorEnv  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402

Array = NDArray[Any]
Reward = Callable[[Array, Array], Array]  # signals, shape (n, signals), and commands, shape (n, commands)


class MachinesEnv(VectorEnv[Array, Array, Array]):
    """n machines, each with its own commands, in the form of `gymnasium.vector.VectorEnv`.

    An episode ends after `horizon` seconds (truncated) or when the machine fails, such as at a violated
    requirement (terminated). The machine starts anew at the step after that (AutoresetMode.NEXT_STEP).
    """

    def __init__(
        self,
        system: System | str | Path,
        num_envs: int,
        commands: Mapping[str, tuple[float, float]],
        signals: Sequence[str],
        reward: Reward,
        *,
        period: float = 0.05,
        horizon: float = 20.0,
        starts: Mapping[str, tuple[float, float]] | None = None,
        **options: Any,
    ) -> None:
        """Raises NotInLanes if the system has other than native FMUs, or the compiler is missing.

        commands   input -> smallest and largest value, in the unit of the FMU; held over a period
        signals    observed variables, `component.variable`, in the units of the FMUs
        reward     of signals and commands; gives one number for each machine
        period     of a step of the environment [s]
        starts     parameter or start value -> limits between which it is drawn for each episode
        options    of `Machines`, such as step, swap, set, workers
        """
        self.machines = Machines(system, num_envs, [*commands], signals, **options)
        self._steps, self._horizon = round(period / self.machines.step), round(horizon / period)
        if self._steps < 1 or abs(self._steps * self.machines.step - period) > 1e-9 * period:
            raise Problem(f"period: expected a multiple of the step {self.machines.step:g} s, got {period:g} s")
        self.num_envs, self.metadata = num_envs, {"autoreset_mode": AutoresetMode.NEXT_STEP}
        low, high = np.array([*commands.values()], np.float32).T
        self.single_action_space = Box(low, high)
        self.single_observation_space = Box(-np.inf, np.inf, (len(signals),), np.float64)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._reward, self._starts = reward, dict(starts or {})
        self._ended, self._age = np.ones(num_envs, np.bool_), np.zeros(num_envs, np.int64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start all machines; the seed determines what is drawn for all later episodes."""
        super().reset(seed=seed, options=options)
        self._ended[:], self._age[:] = False, 0
        self._signals = self._start(np.ones(self.num_envs, np.bool_))
        return self._signals, {}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Hold the commands over a period; machines whose episode has ended start anew instead."""
        again = self._ended
        signals = self.machines.advance(actions, self._steps)
        if again.any():
            signals = self._start(again)
        failed = np.isnan(signals).any(axis=1)
        self._age = np.where(again, 0, self._age + 1)
        self._signals = np.where(failed[:, None], self._signals, signals)
        rewards = np.where(again | failed, 0.0, self._reward(self._signals, actions))
        truncated = ~failed & (self._age >= self._horizon)
        self._ended = failed | truncated
        infos = {"reason": np.array(self.machines.reasons), "_reason": failed} if failed.any() else {}
        return self._signals, rewards, failed, truncated, infos

    def _start(self, chosen: NDArray[np.bool_]) -> Array:
        """Start machines from drawn values; returns the signals of all."""
        drawn = {
            name: self.np_random.uniform(low, high, self.num_envs) for name, (low, high) in self._starts.items()
        }
        return self.machines.start(drawn, chosen)

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        self.machines.close()
