"""Episodes are drawn as a task's distribution says."""

import jax
import numpy as np
import pytest

from crsfd_jax.options.randomisation import HELD_OUT, TRAINING, Randomisation
from crsfd_jax.scene import kinematics, randomize

COUNT = 20_000


@pytest.fixture(scope="module")
def pool(links):
    return randomize.start_pool(links)


def drawn(pool, key=0, shapes=(1, 3, 4), shift=8e-3, friction=(0.5, 1.5), **arm):
    arm = Randomisation(friction=friction, **arm)
    distribution = randomize.Distribution(pool, shapes, shift, 1.0, arm)
    return randomize.draw(distribution, jax.random.key(key), COUNT)


def test_starts_fill_a_cube_above_the_mouth_upright(links, pool):
    position, rotation, _ = jax.jit(lambda q: kinematics.tip_pose(links, q))(pool)
    position = np.asarray(position)
    np.testing.assert_allclose(kinematics.rotation_vector(rotation), 0, atol=1e-4)
    low, high = np.array([-0.03, -0.03, 0.01]), np.array([0.03, 0.03, 0.07])
    assert (position > low - 1e-5).all() and (position < high + 1e-5).all()
    # Uniform in the cube: means and standard deviations per axis, independent axes.
    np.testing.assert_allclose(position.mean(axis=0), (low + high) / 2, atol=1.5e-3)
    np.testing.assert_allclose(position.std(axis=0), 0.06 / np.sqrt(12), rtol=0.03)
    np.testing.assert_allclose(np.corrcoef(position.T), np.eye(3), atol=0.06)


def test_pools_follow_their_seed(links, pool):
    np.testing.assert_array_equal(randomize.start_pool(links, seed=0), pool)
    assert not np.array_equal(randomize.start_pool(links, seed=1), pool)


def test_every_start_is_at_rest_and_from_the_pool(pool):
    state, _ = drawn(pool)
    rows = {row.tobytes() for row in pool}
    qpos = np.asarray(state.qpos)
    assert all(row.tobytes() in rows for row in qpos[:500])
    assert len(np.unique(qpos, axis=0)) > 0.98 * len(pool), "some starts are never drawn"
    assert not np.any(state.qvel) and not np.any(state.warmstart)


def test_offsets_are_uniform_in_a_square_of_the_side_of_the_shift(pool):
    offset = np.asarray(drawn(pool)[1].socket_offset)
    assert np.abs(offset).max() <= 4e-3
    assert np.abs(offset).max() > 3.99e-3
    np.testing.assert_allclose(offset.mean(axis=0), 0, atol=1e-4)
    np.testing.assert_allclose(offset.std(axis=0), 8e-3 / np.sqrt(12), rtol=0.02)
    assert abs(np.corrcoef(offset.T)[0, 1]) < 0.03


def test_without_shift_every_socket_is_in_its_nominal_place(pool):
    assert not np.any(drawn(pool, shift=0.0)[1].socket_offset)


def test_shapes_are_drawn_with_equal_chance_and_no_others(pool):
    shape = np.asarray(drawn(pool)[1].shape)
    values, counts = np.unique(shape, return_counts=True)
    np.testing.assert_array_equal(values, [1, 3, 4])
    np.testing.assert_allclose(counts / COUNT, 1 / 3, atol=0.02)
    assert shape.dtype == np.int32


def test_friction_stays_between_its_bounds(pool):
    friction = np.asarray(drawn(pool)[1].friction)
    assert friction.min() >= 0.5 and friction.max() <= 1.5
    np.testing.assert_allclose(friction.mean(), 1.0, atol=0.01)
    assert (np.asarray(drawn(pool, friction=(0.7, 0.7))[1].friction) == np.float32(0.7)).all()


def test_start_offset_shape_and_friction_are_drawn_independently(pool):
    state, around = drawn(pool)
    columns = (state.qpos[:, 0], *around.socket_offset.T, around.shape, around.friction)
    assert np.abs(np.corrcoef(columns) - np.eye(5)).max() < 0.03


def test_equal_keys_draw_equal_episodes_and_others_do_not(pool):
    first, again, other = drawn(pool), drawn(pool), drawn(pool, key=1)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first[1].socket_offset, other[1].socket_offset)
    assert not np.array_equal(first[0].qpos, other[0].qpos)


def test_friction_is_a_factor_of_the_nominal_one(pool):
    distribution = randomize.Distribution(pool, (0,), 0.0, 0.3, Randomisation(friction=(1.0, 2.0)))
    friction = np.asarray(randomize.draw(distribution, jax.random.key(0), COUNT)[1].friction)
    assert friction.min() >= 0.3 and friction.max() <= 0.6
    np.testing.assert_allclose(friction.mean(), 0.45, atol=0.005)


def test_by_default_the_arm_is_its_model(pool):
    around = drawn(pool, friction=(1.0, 1.0))[1]
    assert (around.friction == 1.0).all()
    assert around.gains is around.encoder_offset is around.is_delayed is around.noise_seed is None
    assert around.socket_yaw is None


@pytest.mark.parametrize(
    "ends", [(0.9, 1.1), (0.6, 1.0, 2.0, 2.4), (-3.0, -2.0, 0.0, 0.5, 1.0, 2.5)]
)
def test_ranges_are_drawn_from_as_often_as_they_are_wide(ends):
    values = np.asarray(randomize.uniform(jax.random.key(0), (COUNT,), ends))
    low, high = np.array(ends[::2], np.float32), np.array(ends[1::2], np.float32)
    for a, b in zip(low, high, strict=True):
        inside = values[(values >= a) & (values <= b)]
        share = (b - a) / (high - low).sum()
        np.testing.assert_allclose(len(inside) / COUNT, share, atol=0.02)
        np.testing.assert_allclose(inside.mean(), (a + b) / 2, atol=0.02 * (b - a))
        np.testing.assert_allclose(inside.std(), (b - a) / np.sqrt(12), rtol=0.03)
    assert all(((v >= low) & (v <= high)).any() for v in values[:2000])


def test_a_range_of_one_number_gives_that_number():
    assert (randomize.uniform(jax.random.key(0), (9,), (0.7, 0.7)) == np.float32(0.7)).all()


def test_each_effect_is_drawn_for_itself_and_leaves_the_others_as_they_were(pool):
    plain, arm = drawn(pool), {k: v for k, v in vars(TRAINING).items() if k != "friction"}
    state, around = drawn(pool, **{**arm, "socket_yaw": (-0.05, 0.1)})
    extra = [around.gains, around.encoder_offset, around.is_delayed, around.noise_seed]
    gains, offset, is_delayed, seed = map(np.asarray, extra)
    yaw = np.asarray(around.socket_yaw)
    np.testing.assert_array_equal(state.qpos, plain[0].qpos)
    for name in ("shape", "socket_offset", "friction"):
        np.testing.assert_array_equal(getattr(around, name), getattr(plain[1], name))
    columns = (
        *(state.qpos[:, 0], around.friction, *around.socket_offset.T, *gains.T),
        *(*offset.T, is_delayed, seed.astype(float), yaw),
    )
    assert np.abs(np.corrcoef(columns) - np.eye(len(columns))).max() < 0.03
    np.testing.assert_allclose(is_delayed.mean(), 0.5, atol=0.02)
    assert len(np.unique(seed)) > COUNT - 10
    np.testing.assert_allclose([yaw.min(), yaw.max()], [-0.05, 0.1], atol=1e-4)
    for drawn_gains, ends in zip(gains.T, (TRAINING.stiffness, TRAINING.damping), strict=True):
        ends_found = drawn_gains.min(), drawn_gains.max()
        np.testing.assert_allclose(ends_found, (min(ends), max(ends)), atol=1e-3)
    inside = [(low <= offset) & (offset <= high) for low, high in _ranges(TRAINING.encoder_offset)]
    assert np.any(inside, axis=0).all()


def _ranges(ends):
    return list(zip(ends[::2], ends[1::2], strict=True))


def test_the_held_out_ranges_share_nothing_with_those_of_training():
    for name in ("friction", "stiffness", "damping", "encoder_offset"):
        own, others = (_ranges(getattr(each, name)) for each in (HELD_OUT, TRAINING))
        assert all(b <= low or a >= high for a, b in own for low, high in others), name
    assert HELD_OUT.position_noise > TRAINING.position_noise > 0
    assert HELD_OUT.rotation_noise > TRAINING.rotation_noise > 0
