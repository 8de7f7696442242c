"""The arms of the ablation and the control: each lacks a part of what makes CRSfD."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest

from crsfd_jax import algorithms
from crsfd_jax.cli import parse
from crsfd_jax.config import Config, Potential
from crsfd_jax.errors import UserError
from crsfd_jax.learn import potential
from crsfd_jax.learn.replay import Backup, Batch
from crsfd_jax.observation import TIP_POSE

LENGTH = 8


def preparation():
    """One demonstration that moves the tip by 0.1 a step and ends in success."""
    demos = probe_env.preparation(LENGTH).demos
    obs = jnp.zeros_like(demos.obs).at[:, TIP_POSE.start].set(0.1 * jnp.arange(LENGTH))
    ends = jnp.arange(LENGTH) == LENGTH - 1
    demos = demos.replace(
        obs=obs,
        next_obs=obs.at[:, TIP_POSE.start].add(0.1),
        terminated=ends,
        reward=ends.astype(jnp.float32),
    )
    return probe_env.preparation()._replace(demos=demos)


def fitted(name, free_space_weight=1.0):
    method = algorithms.load(name)
    config = Config(
        potential=Potential(
            gamma=0.8, steps=1500, hidden=(32, 32), free_space_weight=free_space_weight
        )
    )
    config = method.configure(config)
    return method.prepare(jax.random.key(0), preparation(), config), config


def mean_in_free_space(name):
    learned, _ = fitted(name)
    far = probe_env.free_space(jax.random.key(1), 4000)
    return float(jnp.mean(potential.evaluate(learned, far)))


def test_without_its_regression_free_space_is_not_near_zero():
    assert mean_in_free_space("crsfd") < 0.05
    assert mean_in_free_space("crsfd_no_free_space") > 0.2


def test_with_the_same_gamma_a_demonstrated_step_earns_nothing_and_otherwise_something():
    demos = preparation().demos
    step = Backup(
        reward=demos.reward,
        next_obs=demos.next_obs,
        terminated=demos.terminated,
        length=jnp.ones(LENGTH, jnp.int32),
    )
    batch = Batch(
        obs=demos.obs,
        action=demos.action,
        weight=jnp.ones(LENGTH),
        one_step=step,
        n_step=step,
    )
    earned = {}
    for name in ("crsfd", "crsfd_same_gamma"):
        learned, config = fitted(name, free_space_weight=0.0)
        shaped = algorithms.load(name).reward(learned, batch, config).one_step.reward
        earned[name] = np.asarray(shaped)[:-1]
    np.testing.assert_allclose(earned["crsfd_same_gamma"], 0.0, atol=0.02)
    value = 0.8 ** np.arange(LENGTH - 1, 0, -1)
    # The fit rounds off the edge between the slope and the success state, which is worth 1.
    np.testing.assert_allclose(earned["crsfd"][:-2], ((0.98 / 0.8 - 1) * value)[:-2], atol=0.02)


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("crsfd_no_free_space", {"free_space_weight": 0.0}),
        ("crsfd_same_gamma", {"gamma": 0.98}),
    ],
)
def test_an_arm_differs_from_the_method_in_one_option(name, changed):
    config = Config()
    arm, whole = algorithms.load(name), algorithms.load("crsfd")
    expected = dataclasses.replace(config.potential, **changed)
    assert arm.configure(config) == dataclasses.replace(config, potential=expected)
    assert arm._replace(configure=whole.configure, idle=whole.idle) == whole


@pytest.mark.parametrize("name", ["crsfd", "crsfd_no_free_space"])
def test_a_demonstrated_discount_above_the_tasks_is_refused(name):
    line = ["--algorithm", name, "--potential.gamma", "0.99"]
    with pytest.raises(UserError, match=r"potential\.gamma: got 0\.99, allowed: at most"):
        parse(Config, line)
    parse(Config, ["--algorithm", "crsfd_same_gamma", "--sac.gamma", "0.94"])
    parse(Config, ["--algorithm", "sacfd", *line[2:]])
