"""The tanh-Gaussian policy and the critic ensemble, against float64 numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from crsfd_jax.config import Sac
from crsfd_jax.learn import networks

SAC = Sac(hidden=(16, 16))


def test_log_prob_agrees_with_a_numeric_jacobian_in_float64():
    rng = np.random.default_rng(0)
    mean, log_std = rng.normal(size=(2, 50, 3))
    pre_tanh = rng.normal(size=(50, 3))
    step = 1e-6
    slope = (np.tanh(pre_tanh + step) - np.tanh(pre_tanh - step)) / (2 * step)
    std = np.exp(log_std)
    normal = np.exp(-0.5 * ((pre_tanh - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi))
    expected = np.sum(np.log(normal / slope), axis=-1)
    actual = networks.log_prob(jnp.asarray(mean), jnp.asarray(log_std), jnp.asarray(pre_tanh))
    np.testing.assert_allclose(actual, expected, rtol=1e-4, atol=1e-4)


def test_the_squashed_density_integrates_to_one():
    mean, log_std = jnp.asarray([0.3]), jnp.asarray([-0.7])
    action = np.linspace(-1 + 1e-6, 1 - 1e-6, 200_001)
    density = np.exp(networks.log_prob(mean, log_std, jnp.arctanh(jnp.asarray(action))[:, None]))
    assert np.trapezoid(density, action) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("pre_tanh", [-40.0, -12.0, 12.0, 40.0])
def test_log_prob_and_its_gradient_stay_finite_at_saturated_actions(pre_tanh):
    value, slope = jax.value_and_grad(lambda u: networks.log_prob(jnp.zeros(1), jnp.zeros(1), u))(
        jnp.asarray([pre_tanh])
    )
    expected = -0.5 * pre_tanh**2 - 0.5 * np.log(2 * np.pi) + 2 * abs(pre_tanh) - 2 * np.log(2)
    assert value == pytest.approx(expected, rel=1e-5)
    assert np.isfinite(slope).all()


def test_log_std_stays_in_its_range_and_keeps_a_gradient():
    actor = networks.Actor((8,), 2)
    params = actor.init(jax.random.key(0), jnp.zeros(3))
    _, log_std = actor.apply(params, 1e4 * jax.random.normal(jax.random.key(1), (100, 3)))
    low, high = networks.LOG_STD_RANGE
    assert log_std.min() >= low and log_std.max() <= high
    assert log_std.min() < low + 0.1 and log_std.max() > high - 0.1
    slopes = jax.grad(lambda p: actor.apply(p, jnp.ones(3))[1].sum())(params)
    assert max(np.abs(x).max() for x in jax.tree.leaves(slopes)) > 0


def test_sampled_actions_have_the_moments_of_the_policy_and_the_mode_is_its_squashed_mean():
    actor = networks.Actor((8,), 2)
    obs = jnp.asarray([0.5, -1.0, 2.0])
    params = actor.init(jax.random.key(0), obs)
    mean, log_std = actor.apply(params, obs)
    action, log_prob = networks.sample_action(
        actor, params, jnp.tile(obs, (20_000, 1)), jax.random.key(1)
    )
    pre_tanh = np.arctanh(np.asarray(action, np.float64))
    np.testing.assert_allclose(pre_tanh.mean(0), mean, atol=0.02)
    np.testing.assert_allclose(pre_tanh.std(0), np.exp(log_std), rtol=0.03)
    recomputed = networks.log_prob(mean, log_std, jnp.asarray(pre_tanh))
    np.testing.assert_allclose(log_prob, recomputed, atol=1e-3)
    np.testing.assert_allclose(networks.mode_action(actor, params, obs), np.tanh(mean), rtol=1e-6)


def test_critics_of_the_ensemble_differ_and_agree_with_numpy():
    critic = networks.make_networks(SAC, action_size=2).critic
    rng = np.random.default_rng(0)
    obs, action = rng.normal(size=(7, 5)), rng.uniform(-1, 1, size=(7, 2))
    params = critic.init(jax.random.key(0), jnp.zeros(5), jnp.zeros(2))
    q = critic.apply(params, jnp.asarray(obs), jnp.asarray(action))
    assert q.shape == (2, 7)
    for member in range(2):
        np.testing.assert_allclose(
            q[member], numpy_q(params, member, obs, action), rtol=1e-4, atol=1e-4
        )
    assert np.abs(q[0] - q[1]).max() > 0.01


def test_critics_do_not_grow_with_the_size_of_their_input():
    critic = networks.make_networks(SAC, action_size=2).critic
    params = critic.init(jax.random.key(0), jnp.zeros(5), jnp.zeros(2))
    obs = jax.random.normal(jax.random.key(1), (64, 5))
    near, far = (critic.apply(params, scale * obs, jnp.zeros((64, 2))) for scale in (10.0, 1e5))
    np.testing.assert_allclose(near, far, atol=0.02)


def numpy_q(params, member, obs, action):
    """Forward pass of one critic in float64, written from the definition of layer norm."""
    (layers,) = params["params"].values()
    x = np.concatenate([obs, action], axis=-1)
    names = sorted(layers)
    for name in names:
        x = x @ np.asarray(layers[name]["kernel"][member], np.float64)
        x = x + np.asarray(layers[name]["bias"][member], np.float64)
        if name != names[-1]:
            x = (x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-6)
            x = np.maximum(x, 0.0)
    return x[:, 0]
