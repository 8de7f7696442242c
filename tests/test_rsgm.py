"""RS-GM: its potential, and that a critic with it inside is a critic of shaped rewards."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest
import random_batch
from random_batch import BATCH

from crsfd_jax import config
from crsfd_jax.algorithms import rsgm
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.demos import builtin
from crsfd_jax.learn import networks, sac, wgan
from crsfd_jax.learn.discriminator import PENALTY, Score
from crsfd_jax.learn.replay import Batch
from crsfd_jax.training import train_step
from crsfd_jax.types import Transition

OBS, ACTION, GAMMA = 4, 2, 0.9
SAC = config.Sac(hidden=(8, 8), gamma=GAMMA, initial_alpha=0.3, reward_scale=1.0)
CONFIG = config.Config(sac=SAC)
NETS = networks.make_networks(CONFIG.sac, ACTION)
QUICK = config.Config(potential=config.Potential(steps=1000, hidden=(32, 32)))


@pytest.fixture(name="batch", scope="module")
def make_batch() -> Batch:
    return random_batch.batch(OBS, ACTION)


@pytest.fixture(name="agent", scope="module")
def make_agent() -> sac.AgentState:
    init = jax.jit(lambda key: sac.init(NETS, OBS, key, CONFIG))
    # A target that differs from the critic shows which of the two is used.
    return dataclasses.replace(
        init(jax.random.key(0)), target_critic=init(jax.random.key(9)).critic
    )


@pytest.fixture(name="potential", scope="module")
def make_potential() -> wgan.WganPotential:
    params = Score((8,)).init(jax.random.key(5), jnp.zeros(OBS + ACTION))
    one = jnp.asarray(1.0)
    return wgan.WganPotential(params=params, middle=0.2 * one, scale=0.5 * one, hidden=(8,))


def phi(potential, obs, action):
    return rsgm.WEIGHT * wgan.evaluate(potential, jnp.concatenate([obs, action], axis=-1))


def explicit_targets(potential, agent, batch, key):
    """Targets [2, B] of Q' from r + gamma^m Phi(s', a') - Phi(s, a), with Phi zero at the end."""
    backups = jax.tree.map(lambda *x: jnp.stack(x), batch.one_step, batch.n_step)
    action, _ = networks.sample_action(NETS.actor, agent.actor, backups.next_obs, key)
    after = jnp.where(backups.terminated, 0.0, phi(potential, backups.next_obs, action))
    shaping = GAMMA**backups.length * after - phi(potential, batch.obs, batch.action)
    shaped = dataclasses.replace(backups, reward=backups.reward + shaping)
    return sac.bootstrap_targets(NETS, agent, shaped, GAMMA, key, sac.soft_value)


def test_critic_with_the_potential_inside_learns_as_one_of_shaped_rewards(agent, batch, potential):
    key, weights = jax.random.key(3), jnp.asarray([1.0, 0.5])
    shaped = rsgm.networks(potential, NETS, CONFIG)
    backups = jax.tree.map(lambda *x: jnp.stack(x), batch.one_step, batch.n_step)
    targets = sac.bootstrap_targets(shaped, agent, backups, GAMMA, key, sac.soft_value)
    loss = jax.value_and_grad(sac.critic_loss, has_aux=True)
    (inside, (inside_error, _)), inside_grad = loss(agent.critic, shaped, batch, targets, weights)
    expected = explicit_targets(potential, agent, batch, key)
    (outside, (outside_error, _)), outside_grad = loss(agent.critic, NETS, batch, expected, weights)
    assert inside == pytest.approx(float(outside), rel=1e-5)
    np.testing.assert_allclose(inside_error, outside_error, rtol=1e-4, atol=1e-6)
    for a, b in zip(jax.tree.leaves(inside_grad), jax.tree.leaves(outside_grad), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)


def test_the_potential_grows_with_the_rewards(potential):
    tenfold = dataclasses.replace(CONFIG, sac=dataclasses.replace(CONFIG.sac, reward_scale=10.0))
    one, ten = (rsgm.networks(potential, NETS, c).critic.weight for c in (CONFIG, tenfold))
    assert one == rsgm.WEIGHT and ten == pytest.approx(10 * rsgm.WEIGHT)


def test_the_actor_maximises_what_is_learned_plus_the_potential(agent, batch, potential):
    key = jax.random.key(4)

    def explicit(actor, share):
        action, log_prob = networks.sample_action(NETS.actor, actor, batch.obs, key)
        q = jnp.min(networks.apply(NETS.critic, agent.critic, batch.obs, action), axis=0)
        q = q + share * phi(potential, batch.obs, action)
        return jnp.mean(batch.weight * (jnp.exp(agent.log_alpha) * log_prob - q))

    shaped = rsgm.networks(potential, NETS, CONFIG)
    given = agent.actor, shaped, agent, batch, key, jnp.min
    actual = jax.grad(sac.actor_loss, has_aux=True)(*given)[0]
    expected, naive = (jax.grad(explicit)(agent.actor, share) for share in (1.0, 0.0))
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6)
    pairs = zip(jax.tree.leaves(actual), jax.tree.leaves(naive), strict=True)
    assert max(float(jnp.abs(a - b).max()) for a, b in pairs) > 3e-3


def test_the_potential_is_high_on_unseen_demonstrations_low_elsewhere_and_never_outside_0_and_1():
    file = builtin.load("builtin")
    names = [field.name for field in dataclasses.fields(Transition)]
    demos = Transition(**{name: jnp.asarray(getattr(file, name)) for name in names})
    steps = int(file.episode_length[:30].sum())
    seen, unseen = (jax.tree.map(lambda x, i=i: x[i], demos) for i in np.s_[:steps, steps:])
    preparation = Preparation(demos=seen, free_space=probe_env.free_space)
    fit = jax.jit(lambda key: rsgm.prepare(key, preparation, QUICK))
    potential = fit(jax.random.key(0))
    evaluate = jax.jit(lambda obs, action: phi(potential, obs, action) / rsgm.WEIGHT)
    any_action = jax.random.uniform(jax.random.key(1), unseen.action.shape, minval=-1.0)
    on_demos = evaluate(unseen.obs, unseen.action)
    off_action = evaluate(unseen.obs, any_action)
    off_state = evaluate(unseen.obs + 2.0, unseen.action)
    assert on_demos.mean() > 0.7 and off_action.mean() < 0.55 and off_state.mean() < 0.2
    assert (on_demos > off_action).mean() > 0.85
    everywhere = jnp.concatenate([on_demos, off_action, off_state])
    assert (everywhere >= 0).all() and (everywhere <= 1).all()


def test_critic_loss_of_a_linear_score_is_the_gap_of_means_plus_the_penalty():
    real, fake = np.random.default_rng(0).normal(size=(2, BATCH, 3))
    params = Score(()).init(jax.random.key(1), jnp.zeros(3))
    weight = np.asarray(params["params"]["Dense_0"]["kernel"])[:, 0]
    expected = (fake.mean(0) - real.mean(0)) @ weight
    expected += PENALTY * (np.linalg.norm(weight) - 1) ** 2
    actual = wgan.critic_loss(Score(()), params, real, fake, np.linspace(0, 1, BATCH))
    assert actual == pytest.approx(expected, rel=1e-4)


def test_rsgm_learns_the_probe_with_its_potential_frozen():
    potential = config.Potential(steps=50, hidden=(8, 8))
    options = probe_env.eager_config("rsgm", potential=potential)
    learner = train_step.make(probe_env.make(), rsgm.METHOD, options)
    init = jax.jit(jax.vmap(lambda key: learner.init(key, probe_env.preparation())))
    states = init(jax.vmap(jax.random.key)(jnp.arange(3)))
    before = jax.tree.map(np.asarray, states.prepared)
    states, _ = probe_env.assert_learned(learner, states)
    jax.tree.map(np.testing.assert_array_equal, before, states.prepared)
