"""`MachinesEnv`: what Gymnasium asks of an environment, and the physics of `run`."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from kit.mistakes import problem

from orchestrator.lanes.environment import MachinesEnv
from orchestrator.lanes.machines import Machines

COMMANDS = {"swing_command": (-10.0, 10.0), "boom_command": (-10.0, 10.0), "stick_command": (-10.0, 10.0)}
ANGLES = ["manipulator.swing_angle", "manipulator.boom_angle", "manipulator.stick_angle"]
ANGLE = {"manipulator.initial_boom_angle": (0.2, 0.5)}
VARY = {"manipulator.head_mass": (300.0, 400.0), **ANGLE}
INTERVAL = 0.05  # [s]


def height(observations, _):
    """The reward: the angle of the boom [rad]."""
    return observations[:, 1]


@pytest.fixture
def make(system):
    """make(n, ...): an environment of n machines, closed at the end."""
    made = []

    def environment(count, **options):
        made.append(MachinesEnv(system, count, COMMANDS, ANGLES, height, **{"vary": VARY, **options}))
        return made[-1]

    yield environment
    for one in made:
        one.close()


class One(gymnasium.Env):
    """One machine: the checker knows no vector environments."""

    metadata = {"render_modes": []}  # noqa: RUF012
    spec = gymnasium.envs.registration.EnvSpec("One-v0", entry_point=None)

    def __init__(self, many):
        self.many = many
        self.action_space, self.observation_space = many.single_action_space, many.single_observation_space

    def reset(self, *, seed=None, options=None):
        """The first row."""
        super().reset(seed=seed)
        observations, info = self.many.reset(seed=seed, options=options)
        self._np_random = self.many.np_random
        return observations[0], info

    def step(self, action):
        """The first rows."""
        observations, rewards, terminated, truncated, info = self.many.step(action[None])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info


# the checker recommends limits of -1 and 1 for actions, and finite ones for observations; here: V and rad
@pytest.mark.filterwarnings("ignore:.*Box (action|observation) space")
def test_the_checker_of_gymnasium_passes(make):
    """Spaces, seeds, types of results, equal steps after equal seeds, and no array that is changed later."""
    check_env(One(make(1)), skip_render_check=True, skip_close_check=True)


def test_spaces_and_results_have_a_row_for_each_machine(make):
    """Also through wrappers of Gymnasium, which read the mode in which machines start again."""
    many = make(9)
    assert many.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert many.action_space.shape == many.observation_space.shape == (9, 3)
    wrapped = RecordEpisodeStatistics(NormalizeObservation(many))
    assert wrapped.reset(seed=3)[0].shape == (9, 3)
    many.action_space.seed(3)
    for _ in range(3):
        action = many.action_space.sample()
        assert action in many.action_space
        found = [(a.shape, a.dtype.kind) for a in wrapped.step(action)[:4]]
        assert found == [((9, 3), "f"), ((9,), "f"), ((9,), "b"), ((9,), "b")]


def test_machines_start_again_after_their_end(make):
    """At the step after the end, with new values and without a reward; the others go on to their duration."""
    many = make(9, duration=4 * INTERVAL, ends=lambda seen: seen[:, 1] > 0.35, vary=ANGLE)
    hold = np.zeros((9, 3))  # the boom sinks by less than 1e-3 rad
    first, _ = many.reset(seed=5)
    high = first[:, 1] > 0.35
    assert 0 < high.sum() < 9
    _, rewards, terminated, truncated, _ = many.step(hold)
    np.testing.assert_array_equal(terminated, high)
    assert not truncated.any()
    assert (rewards != 0.0).all()
    again, rewards, terminated, _, _ = many.step(hold)
    np.testing.assert_array_equal(rewards == 0.0, high)
    assert not terminated.any()
    moved = np.abs(again[:, 1] - first[:, 1])
    assert (moved[~high] < 1e-3).all()
    assert (moved[high] > 1e-3).all()
    many.step(hold)
    truncated = many.step(hold)[3]
    np.testing.assert_array_equal(truncated[~high], True)
    np.testing.assert_array_equal(truncated[high], False)
    start = many.step(hold)[0]
    assert (np.abs(start[~high, 1] - first[~high, 1]) > 1e-3).all()


def test_a_machine_that_fails_ends_its_episode_with_a_reason(make):
    """The last observation before the failure is kept, and the machine starts again."""
    many = make(9, vary={}, set={"manipulator.stop_stiffness": 1e3}, interval=1.0)
    many.reset(seed=1)
    push = np.where(np.arange(9)[:, None] == 2, [[0.0, 10.0, 10.0]], [[0.0, 0.0, 0.0]])
    for _ in range(12):
        seen, _, terminated, _, info = many.step(push)
        assert seen in many.observation_space
        if terminated.any():
            break
    np.testing.assert_array_equal(terminated, np.arange(9) == 2)
    assert "requirement" in info["reason"][2]
    assert not many.step(push)[2].any()


def test_actions_are_commands_over_an_interval(make, system):
    """Observations are the signals of the machines that are stepped with the same commands."""
    actions = np.random.default_rng(6).uniform(-4.0, 4.0, (4, 9, 3))
    many = make(9, vary=ANGLE)
    seen, _ = many.reset(seed=7)
    machines = Machines(system, 9, [*COMMANDS], ANGLES)
    machines.start({name: seen[:, 1] for name in ANGLE})
    for row in actions:
        np.testing.assert_array_equal(many.step(row)[0], machines.advance(row, round(INTERVAL / 1e-3)))
    machines.close()


def test_mistakes_are_told(system):
    """The interval must consist of communication steps, and an action needs limits."""
    message = problem(lambda: MachinesEnv(system, 1, COMMANDS, ANGLES, height, interval=0.0015))
    assert message == "interval: expected a multiple of the step of 0.001 s, got 0.0015 s"
    message = problem(lambda: MachinesEnv(system, 1, ["boom_command"], ANGLES, height))
    assert message.startswith("actions: boom_command: expected limits, because the FMU declares none")
