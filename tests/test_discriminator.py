"""The discriminator's loss and its gradient against numpy, and what it learns on a toy set."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from crsfd_jax.learn import discriminator
from crsfd_jax.learn.discriminator import Score

FEATURES, WIDTH, BATCH = 3, 4, 5


def toy_rows():
    expert, agent = np.random.default_rng(0).normal(size=(2, BATCH, FEATURES))
    return expert, agent, np.linspace(0.1, 0.9, BATCH)


def gradient_of(hidden, params, rows):
    return jax.jit(jax.grad(discriminator.loss, argnums=1), static_argnums=0)(
        Score(hidden), params, *rows
    )


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def test_gradient_of_a_linear_score_equals_the_one_on_paper():
    rows = expert, agent, _ = toy_rows()
    params = Score(()).init(jax.random.key(1), jnp.zeros(FEATURES))
    layer = params["params"]["Dense_0"]
    weight, bias = np.asarray(layer["kernel"], np.float64)[:, 0], 0.0
    wrong_expert = sigmoid(-(expert @ weight + bias))
    wrong_agent = sigmoid(agent @ weight + bias)
    length = np.linalg.norm(weight)
    cross_entropy = np.mean(wrong_agent[:, None] * agent - wrong_expert[:, None] * expert, axis=0)
    penalty = discriminator.PENALTY * 2 * (length - 1) * weight / length
    gradient = gradient_of((), params, rows)["params"]["Dense_0"]
    np.testing.assert_allclose(gradient["kernel"][:, 0], cross_entropy + penalty, rtol=1e-4)
    bias_gradient = np.mean(wrong_agent) - np.mean(wrong_expert)
    np.testing.assert_allclose(gradient["bias"], [bias_gradient], rtol=1e-4)


def loss_in_numpy(flat, unravel, expert, agent, mix):
    """In double precision, with the slope of one tanh layer written out."""
    layers = unravel(flat)["params"]
    first, last = layers["Dense_0"], layers["Dense_1"]

    def hidden(x):
        return np.tanh(x @ first["kernel"] + first["bias"])

    def score(x):
        return hidden(x) @ last["kernel"][:, 0] + last["bias"][0]

    between = mix[:, None] * expert + (1 - mix[:, None]) * agent
    slopes = ((1 - hidden(between) ** 2) * last["kernel"][:, 0]) @ first["kernel"].T
    penalty = np.mean((np.linalg.norm(slopes, axis=1) - 1) ** 2)
    cross_entropy = -np.log(sigmoid(score(expert))) - np.log(1 - sigmoid(score(agent)))
    return np.mean(cross_entropy) + discriminator.PENALTY * penalty


def test_loss_and_gradient_of_a_deep_score_equal_finite_differences_of_numpy():
    rows = toy_rows()
    params = Score((WIDTH,)).init(jax.random.key(2), jnp.zeros(FEATURES))
    flat, unravel_as_jax = ravel_pytree(params)
    flat = np.asarray(flat, np.float64)

    def unravel(values):
        parts, start = {}, 0
        for name, layer in params["params"].items():
            parts[name] = {}
            for key in sorted(layer):
                size, shape = layer[key].size, layer[key].shape
                parts[name][key] = values[start : start + size].reshape(shape)
                start += size
        return {"params": parts}

    jax.tree.map(np.testing.assert_array_equal, unravel(np.float32(flat)), unravel_as_jax(flat))
    actual = discriminator.loss(Score((WIDTH,)), params, *rows)
    assert actual == pytest.approx(loss_in_numpy(flat, unravel, *rows), rel=1e-5)
    steps = 1e-5 * np.eye(len(flat))
    differences = [
        (loss_in_numpy(flat + h, unravel, *rows) - loss_in_numpy(flat - h, unravel, *rows)) / 2e-5
        for h in steps
    ]
    gradient, _ = ravel_pytree(gradient_of((WIDTH,), params, rows))
    np.testing.assert_allclose(gradient, differences, rtol=1e-3, atol=1e-4)


def test_penalty_of_a_slope_of_five_is_sixteen_and_of_a_flat_function_one():
    points = jnp.asarray(toy_rows()[0])
    steep = discriminator.gradient_penalty(lambda x: x @ jnp.asarray([3.0, 0.0, 4.0]), points)
    assert steep == pytest.approx(16.0, rel=1e-5)
    flat, slope = jax.value_and_grad(
        lambda height: discriminator.gradient_penalty(lambda x: height * x[0], points)
    )(0.0)
    assert flat == pytest.approx(1.0, rel=1e-5) and np.isfinite(slope)


def test_demonstrated_rows_score_above_experience_after_training_and_not_before():
    expert_key, agent_key, init_key, key = jax.random.split(jax.random.key(0), 4)
    expert = 1.0 + 0.3 * jax.random.normal(expert_key, (50, FEATURES))
    agent = -1.0 + 0.3 * jax.random.normal(agent_key, (50, FEATURES))
    fresh = discriminator.init(init_key, expert, (16, 16))

    def step(learned, key):
        rows_key, key = jax.random.split(key)
        rows = agent[jax.random.randint(rows_key, (32,), 0, 50)]
        return discriminator.update(learned, rows, key), None

    @jax.jit
    def separate(start):
        trained, _ = jax.lax.scan(step, start, jax.random.split(key, 2000))
        return [discriminator.logits(trained, rows) for rows in (expert, agent)]

    on_expert, on_agent = separate(fresh)
    assert on_expert.min() > 0.5 and on_agent.max() < -0.5
    assert discriminator.logits(fresh, expert).min() < 0.5
    # The penalty keeps the slope near 1: the clusters lie 2 sqrt(3) / 0.3 = 11.5 spreads apart.
    assert 2.5 < on_expert.mean() - on_agent.mean() < 13


def test_the_units_of_features_do_not_matter_to_what_is_learned():
    expert, agent, _ = (jnp.asarray(rows, jnp.float32) for rows in toy_rows())

    def learned(units):
        start = discriminator.init(jax.random.key(3), expert * units, (WIDTH,))
        for key in jax.random.split(jax.random.key(4), 5):
            start = discriminator.update(start, agent * units, key)
        return discriminator.logits(start, agent * units)

    plain, other = learned(jnp.ones(FEATURES)), learned(jnp.array([1.0, 8.0, 50.0]))
    assert np.ptp(plain) > 0.1
    np.testing.assert_allclose(plain, other, atol=1e-4)


def test_a_feature_that_hardly_varies_is_not_blown_up():
    expert = jnp.asarray(toy_rows()[0], jnp.float32) * jnp.array([1e-3, 0.0, 1.0])
    spread = discriminator.init(jax.random.key(0), expert, ()).spread
    np.testing.assert_allclose(spread, [0.1, 0.1, np.std(expert[:, 2])], rtol=1e-6)
