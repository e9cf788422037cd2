"""`MachinesEnv`: many machines in lanes as a vector environment of Gymnasium, for reinforcement learning."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.options import chosen
from orchestrator.data.table import Array
from orchestrator.data.trace import SAME_TIME
from orchestrator.engine.arguments import MachinesArguments
from orchestrator.engine.options import MachinesOptions
from orchestrator.lanes.machines import Machines
from orchestrator.ssp.system import System

try:
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError:
    require("learn", "MachinesEnv")
    raise

Rewards = Callable[[Array, Array], Array]  # (observations, actions) -> rewards, shape (n,)
Ends = Callable[[Array], NDArray[np.bool_]]  # observations -> machines at their end, shape (n,)
Limits = Mapping[str, tuple[float, float]]
STEP = 1e-3  # [s]


class MachinesEnv(VectorEnv):  # type: ignore[misc]  # the package may be missing
    """n machines of native FMUs, in the units of the FMUs. An action is held over a control interval.

    An episode is terminated if `ends` says so or the machine has failed: `info["reason"]` says why, and the
    observation is the last one before. It is truncated after its duration. The next step starts the machine
    again and ignores its action. `info["reason"]` also says of which machines, the mask `info["unreliable"]`,
    the error of the coupling is too large since their start.

    from orchestrator.lanes.environment import MachinesEnv

    def low_tip(observations, actions):
        return -abs(observations[:, 0])

    commands, heads = {"boom_command": (-10.0, 10.0)}, {"manipulator.head_mass": (300.0, 400.0)}
    env = MachinesEnv("build/harvester.ssp", 64, commands, ["manipulator.tip_height"], low_tip, vary=heads)
    observations, info = env.reset(seed=1)
    observations, rewards, terminated, truncated, info = env.step(env.action_space.sample())
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        system: System | str | Path,
        num_envs: int,
        actions: Limits | Sequence[str],
        observations: Sequence[str],
        reward: Rewards,
        *,
        ends: Ends | None = None,
        interval: float = 0.05,
        duration: float = 20.0,
        vary: Limits | None = None,
        truncate_unreliable: bool = False,
        **options: Unpack[MachinesArguments],
    ) -> None:
        """Raises NotInLanes if the system has other than native FMUs, or the compiler is missing.

        actions        inputs with their limits; names alone: the limits that the FMUs declare
        observations   signals, `component.variable`, with the limits that the FMUs declare, if any
        interval       control interval, a multiple of the communication step, whose default is 1e-3 [s]
        duration       of an episode [s]
        vary           parameters or start values that are drawn at each start of a machine, uniformly
        truncate_unreliable   truncate the episodes of machines that are not reliable
        options        those of `batch`, without a time span
        """
        step = options["step"] = chosen(MachinesOptions, options, "MachinesEnv").step or STEP
        self._per_action, self._last = round(interval / step), round(duration / interval)
        if self._per_action < 1 or abs(self._per_action * step - interval) > SAME_TIME * interval:
            raise Problem(f"interval: expected a multiple of the step of {step:g} s, got {interval:g} s")
        if self._last < 1:
            raise Problem(f"duration: expected at least one interval of {interval:g} s, got {duration:g} s")
        self._machines = Machines(system, num_envs, [*actions], observations, **options)
        self._reward, self._ends, self._vary = reward, ends, dict(vary or {})
        self._truncates_unreliable = truncate_unreliable
        limits = actions if isinstance(actions, Mapping) else {}
        self.num_envs, self.spec = num_envs, None
        self.single_action_space = _box([limits.get(n) or self._declared(n, True) for n in actions])
        self.single_observation_space = _box([self._declared(n, False) for n in observations])
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._count, self._over = np.zeros(num_envs, np.int64), np.zeros(num_envs, np.bool_)

    def _declared(self, name: str, needed: bool) -> tuple[float, float]:
        """The limits that the FMU declares; infinite if it declares none."""
        system = self._machines.system
        variable = system.variable(system.targets(name)[0][0] if needed else system.port(name))
        if needed and np.isinf(variable.bounds).any():
            raise Problem(f"actions: {name}: expected limits, because the FMU declares none")
        return variable.bounds

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start all machines, or those of the mask `options["reset_mask"]`; returns observations and info."""
        super().reset(seed=seed)
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs)), np.bool_)
        self._seen = self._start(mask)
        return self._seen.copy(), {}

    def step(self, actions: Any) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold actions, shape (n, actions), over an interval; machines that were at their end start again."""
        fresh, actions = self._over.copy(), np.asarray(actions, np.float64)
        signals, self._count = self._machines.advance(actions, self._per_action), self._count + 1
        if fresh.any():
            signals = self._start(fresh)
        failed = np.asarray(np.isnan(signals).any(axis=1))
        self._seen = np.where(failed[:, None], self._seen, signals)
        terminated = failed if self._ends is None else failed | self._ends(self._seen)
        terminated, truncated = terminated & ~fresh, self._count >= self._last
        reasons = np.array(self._machines.reasons)
        unreliable = (reasons != "") & ~failed & ~fresh
        if self._truncates_unreliable:
            truncated = truncated | unreliable
        rewards = np.where(fresh, 0.0, self._reward(self._seen, actions))
        self._over = np.logical_or(terminated, truncated)
        info: dict[str, Any] = {}
        if (told := failed | unreliable).any():
            info = {"reason": reasons, "_reason": told}
        if unreliable.any():
            info |= {"unreliable": unreliable, "_unreliable": unreliable}
        return self._seen.copy(), rewards, terminated, truncated, info

    def _start(self, mask: NDArray[np.bool_]) -> Array:
        """Start machines with new values; returns the signals of all."""
        drawn = {n: self.np_random.uniform(*limits, self.num_envs) for n, limits in self._vary.items()}
        self._count[mask], self._over[mask] = 0, False
        return self._machines.start(drawn, mask)

    def close_extras(self, **_: object) -> None:
        """End the threads."""
        self._machines.close()


def _box(limits: Sequence[tuple[float, float]]) -> Any:
    low, high = np.array(limits, np.float64).T
    return Box(low, high, dtype=np.float64)
