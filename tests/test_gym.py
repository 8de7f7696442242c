"""The task through Gymnasium: its checkers pass, batches reset in the step that ends an episode."""

import importlib.util
import itertools
import re
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import crsfd_jax.gym  # noqa: E402
from crsfd_jax import cli, env, observation  # noqa: E402
from crsfd_jax.config import Config  # noqa: E402
from crsfd_jax.errors import UserError  # noqa: E402
from crsfd_jax.scene.digits import HOLE_DEPTH  # noqa: E402

TASK = {"shape": 2, "shift": "8mm", "horizon": 5}
COUNT = 4
DOWN = np.array([0, 0, -1, 0, 0, 0], np.float32)


@pytest.fixture
def single():
    return gymnasium.make(crsfd_jax.gym.ID, **TASK)


@pytest.fixture
def batch():
    return gymnasium.make_vec(crsfd_jax.gym.ID, num_envs=COUNT, **TASK)


def random_actions(space, steps, seed=0):
    space.seed(seed)
    return [space.sample() for _ in range(steps)]


def roll(world, steps, seed):
    """All that `reset` and `steps` random steps give."""
    given = [world.reset(seed=seed)]
    return given + [world.step(action) for action in random_actions(world.action_space, steps)]


def put_into_sockets(world, at_rest):
    """Every peg in its own socket, 4 mm above the floor."""
    state = world._state
    offset = np.asarray(state.around.socket_offset)
    height = np.full(len(offset), -HOLE_DEPTH + 4e-3)
    position = np.column_stack([offset, height])
    tip = np.column_stack([position, np.zeros((len(offset), 3))]).astype(np.float32)
    world._state = state.replace(physics=at_rest(position), tip=tip)


def test_one_environment_passes_the_checker_without_a_warning(single):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(single.unwrapped, skip_render_check=True)


def test_an_id_with_the_module_in_front_needs_no_import():
    code = (
        "import gymnasium; "
        "print(gymnasium.make('crsfd_jax.gym:crsfd/Insertion-v0').observation_space.shape)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.stdout.strip() == "(29,)", run.stderr


def test_spaces_are_bounded_and_of_float32(single, batch):
    for world, lead in ((single, ()), (batch, (COUNT,))):
        assert world.observation_space.shape == (*lead, 29) and world.action_space.shape == (
            *lead,
            6,
        )
        for space, bound in ((world.observation_space, 10.0), (world.action_space, 1.0)):
            assert space.dtype == np.float32
            assert (space.low == -bound).all() and (space.high == bound).all()


@pytest.mark.parametrize(
    ("keyword", "value", "argument"),
    [
        ("shape", 7, "--shape=7"),
        ("shift", "8", "--shift=8"),
        ("shift", "9cm", "--shift=9cm"),
        ("friction", -1, "--scene.friction=-1"),
        ("clearance", "30mm", "--scene.clearance=30mm"),
        ("horizon", 0, "--mdp.horizon=0"),
    ],
)
def test_a_bad_value_is_refused_with_the_line_of_the_command_line(keyword, value, argument):
    with pytest.raises(UserError) as told:
        cli.parse(Config, [argument])
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(ValueError) as found:
            make(crsfd_jax.gym.ID, **{keyword: value})
        assert str(found.value) == str(told.value)


def test_keywords_reach_the_task():
    made = crsfd_jax.gym.Insertion(
        shape="3", shift="4mm", friction=0.5, clearance="2mm", horizon=7, engine="native"
    )
    told = made._options
    assert (told.shape, told.shift, told.mdp.horizon) == ("3", 4e-3, 7)
    assert (told.scene.friction, told.scene.clearance) == (0.5, 2e-3)


@pytest.mark.parametrize("make", [gymnasium.make_vec, crsfd_jax.gym.InsertionVector])
def test_a_mode_that_cannot_be_rendered_is_refused(make):
    name = (crsfd_jax.gym.ID,) if make is gymnasium.make_vec else ()
    with pytest.raises(ValueError, match="render_mode: got 'human', allowed: None, rgb_array"):
        make(*name, render_mode="human")


def test_no_environment_at_all_is_refused():
    with pytest.raises(ValueError, match="num_envs: got 0, allowed: at least 1"):
        gymnasium.make_vec(crsfd_jax.gym.ID, num_envs=0)


def test_an_unknown_keyword_is_refused():
    with pytest.raises(TypeError, match="shpae"):
        gymnasium.make(crsfd_jax.gym.ID, shpae="2")


def test_the_time_limit_truncates_one_environment(single):
    single.reset(seed=0)
    ends = [single.step(np.zeros(6, np.float32))[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]


@pytest.mark.parametrize("name", ["single", "batch"])
def test_equal_seeds_give_equal_episodes_and_others_do_not(name, request):
    world = request.getfixturevalue(name)
    one, same, other = (roll(world, 7, seed)[-1][0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


def test_a_reset_without_a_seed_goes_on_with_new_episodes(single):
    first, _ = single.reset(seed=1)
    second, _ = single.reset()
    again, _ = single.reset(seed=1)
    assert (first != second).any() and (first == again).all()


def test_a_batch_goes_on_with_new_episodes_in_every_row(batch):
    given = roll(batch, 2 * TASK["horizon"], 0)
    begun = [given[step][0] for step in (0, TASK["horizon"], 2 * TASK["horizon"])]
    for one, other in itertools.combinations(begun, 2):
        assert (one != other).any(axis=1).all()


def test_a_batch_says_in_its_metadata_how_it_resets(batch):
    assert batch.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.SAME_STEP
    assert type(batch.unwrapped).__name__ == "InsertionVector"


def test_infos_of_a_batch_are_those_that_gymnasium_makes_of_single_environments(batch):
    reference = gymnasium.vector.SyncVectorEnv(
        [lambda: gymnasium.make(crsfd_jax.gym.ID, **TASK)] * COUNT,
        autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP,
    )
    for ours, theirs in zip(roll(batch, 6, 0), roll(reference, 6, 0), strict=True):
        assert described(ours) == described(theirs)


def described(tree):
    if isinstance(tree, dict):
        return {name: described(value) for name, value in tree.items()}
    if isinstance(tree, tuple):
        return [described(value) for value in tree]
    rows = [row if row is None else row.shape for row in tree] if tree.dtype == object else None
    return tree.shape, tree.dtype, rows


def test_an_ended_episode_leaves_its_last_observation_and_a_new_one_begins(batch, at_rest):
    """The final observation is the one of the deepest point, not of the new start."""
    batch.reset(seed=0)
    put_into_sockets(batch.unwrapped, at_rest)
    actions = np.tile(DOWN, (COUNT, 1))
    actions[1] = 0
    obs, reward, terminated, truncated, infos = batch.step(actions)
    ended = np.array([True, False, True, True])
    for found in (terminated, reward == 1, infos["_final_obs"], infos["final_info"]["is_success"]):
        np.testing.assert_array_equal(found, ended)
    assert not truncated.any() and not infos["is_success"].any()
    height = observation.SCALE[16]
    assert infos["final_obs"][1] is None
    for i in np.flatnonzero(ended):
        assert infos["final_obs"][i][16] * height < -env.SUCCESS_DEPTH
        assert obs[i, 16] * height > 0.009
    assert obs[1, 16] * height < -0.02, "the episode that goes on was replaced"


def test_success_of_one_environment_terminates_with_its_info(single, at_rest):
    single.reset(seed=0)
    world = single.unwrapped
    data = world._state.data
    position = np.array([*data.around.socket_offset, -0.026])
    physics = jax.tree.map(lambda leaf: leaf[0], at_rest(position[None]))
    tip = np.array([*position, 0, 0, 0], np.float32)
    placed = data.replace(physics=physics, tip=tip)
    world._state = world._state.replace(data=placed)
    obs, reward, terminated, truncated, info = single.step(DOWN)
    assert (reward, terminated, truncated, info["is_success"]) == (1.0, True, False, True)
    assert obs[16] * observation.SCALE[16] < -env.SUCCESS_DEPTH


def test_a_broken_simulation_is_truncated_inside_the_observation_space(batch):
    before, _ = batch.reset(seed=0)
    world = batch.unwrapped
    physics = world._state.physics
    hurt = physics.replace(qvel=physics.qvel.at[2].set(np.nan))
    world._state = world._state.replace(physics=hurt)
    obs, reward, terminated, truncated, infos = batch.step(np.zeros((COUNT, 6), np.float32))
    np.testing.assert_array_equal(truncated, np.arange(COUNT) == 2)
    np.testing.assert_array_equal(infos["final_obs"][2], before[2])
    assert not terminated.any() and not reward.any() and obs in batch.observation_space


def test_actions_of_another_shape_are_refused(batch, single):
    batch.reset(seed=0)
    single.reset(seed=0)
    with pytest.raises(ValueError, match=r"got shape \(6,\), allowed: \(4, 6\)"):
        batch.step(np.zeros(6))
    with pytest.raises(ValueError, match=r"got shape \(3,\), allowed: \(6,\)"):
        single.unwrapped.step(np.zeros(3))


def test_a_step_before_the_first_reset_is_refused(batch):
    with pytest.raises(gymnasium.error.ResetNeeded):
        batch.step(np.zeros((COUNT, 6), np.float32))


def test_environments_of_equal_options_share_their_compiled_step():
    made = [gymnasium.make_vec(crsfd_jax.gym.ID, num_envs=3, **TASK) for _ in range(2)]
    for world in made:
        roll(world, 2, 0)
    compiled = made[0].unwrapped._batch.step
    assert made[1].unwrapped._batch.step is compiled
    before = compiled._cache_size()
    roll(made[1], 2, 1)
    assert compiled._cache_size() == before


def test_episode_statistics_of_gymnasium_count_on_batches(batch):
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(batch)
    infos = roll(wrapped, 5, 0)[-1][-1]
    np.testing.assert_array_equal(infos["episode"]["l"], 5)


def test_pictures_are_drawn_where_opengl_works():
    try:
        world = gymnasium.make(crsfd_jax.gym.ID, render_mode="rgb_array", **TASK)
    except UserError as error:
        pytest.skip(str(error))
    world.reset(seed=0)
    high = world.render()
    for _ in range(4):
        world.step(DOWN)
    assert high.shape == (480, 640, 3) and high.dtype == np.uint8
    assert (np.abs(high.astype(int) - world.render()).max(axis=2) > 30).mean() > 0.005


CHECK = """
from stable_baselines3.common.env_checker import check_env

check_env(env.unwrapped)
"""


def examples():
    """The Python of the documentation, block by block."""
    text = (Path(__file__).parents[1] / "docs" / "environments.md").read_text()
    return re.findall(r"```python\n(.*?)```", text, re.S)


@pytest.mark.parametrize("code", examples(), ids=["make", "make_vec", "sb3", "functional"])
def test_the_documented_examples_run(code):
    if "stable_baselines3" not in code:
        exec(compile(code, "docs/environments.md", "exec"), {})
        return
    if importlib.util.find_spec("stable_baselines3") is None:
        pytest.skip("Stable-Baselines3 is not installed")
    assert "learn(100_000)" in code
    code = code.replace("learn(100_000)", "learn(150)") + CHECK
    # In a process of its own: PyTorch's compiler and a software OpenGL each bring an LLVM.
    subprocess.run([sys.executable, "-W", "error::UserWarning", "-c", code], check=True)
