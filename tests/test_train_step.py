"""The fused step on a probe environment: what is stored, what is learned, what stays apart."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest

from crsfd_jax import algorithms
from crsfd_jax.options.schedule import warmup_steps
from crsfd_jax.training import chunk, train_step


def learner_and_states(config, env=None, num_demos=6, seeds=3):
    env = env or probe_env.make()
    learner = train_step.make(env, algorithms.load(config.algorithm), config)
    keys = jax.vmap(jax.random.key)(jnp.arange(seeds))
    preparation = probe_env.preparation(num_demos)
    return learner, jax.vmap(lambda key: learner.init(key, preparation))(keys)


def test_seed_in_a_batch_equals_the_seed_alone():
    """Equal up to the order of float32 sums, which differs with the size of a matrix product."""
    config = probe_env.config()
    learner, states = learner_and_states(config)
    together, _ = chunk.make(learner, 24)(states, jnp.int32(0))
    for seed in range(3):
        _, states = learner_and_states(config)
        one = jax.tree.map(lambda leaf, i=seed: leaf[i : i + 1], states)
        alone, _ = chunk.make(learner, 24)(one, jnp.int32(0))
        for a, b in zip(jax.tree.leaves(together.agent), jax.tree.leaves(alone.agent), strict=True):
            np.testing.assert_allclose(a[seed], b[0], rtol=2e-4, atol=2e-5)


def test_seeds_differ():
    learner, states = learner_and_states(probe_env.config())
    after, _ = chunk.make(learner, 8)(states, jnp.int32(0))
    kernel = jax.tree.leaves(after.agent.actor)[-1]
    assert not np.allclose(kernel[0], kernel[1])


def test_two_chunks_equal_one_of_twice_the_length_bit_by_bit():
    config = probe_env.config()
    learner, states = learner_and_states(config)
    once, _ = chunk.make(learner, 16)(states, jnp.int32(0))
    _, states = learner_and_states(config)
    half = chunk.make(learner, 8)
    states, _ = half(states, jnp.int32(0))
    twice, _ = half(states, jnp.int32(8))
    for a, b in zip(jax.tree.leaves(once.agent), jax.tree.leaves(twice.agent), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_chunk_is_compiled_once():
    learner, states = learner_and_states(probe_env.config())
    advance = chunk.of_each(lambda state, own, step: learner.step(state, step), 4)
    for step in range(0, 12, 4):
        states, _ = advance(states, (), jnp.int32(step))
    assert advance._cache_size() == 1


def step_with(method, config, steps=8):
    """States and metrics after steps of a method, from those of one seed."""
    learner = train_step.make(probe_env.make(), method, config)
    states = learner.init(jax.random.key(0), probe_env.preparation(6))
    states = jax.tree.map(lambda leaf: leaf[None], states)
    return chunk.make(learner, steps)(states, jnp.int32(0))


def test_the_reward_scale_multiplies_every_reward_that_is_learned_from_and_no_priority():
    config, sacfd = probe_env.config(), algorithms.load("sacfd")
    doubled = dataclasses.replace(config, sac=dataclasses.replace(config.sac, reward_scale=2.0))

    def shaped(factor):
        def reward(prepared, batch, config):
            one_step, n_step = (
                backup.replace(reward=factor * (backup.reward + 0.25))
                for backup in (batch.one_step, batch.n_step)
            )
            return batch.replace(one_step=one_step, n_step=n_step)

        return sacfd._replace(reward=reward)

    def update(*args):
        agent, td_error, metrics = sacfd.update(*args)
        return agent, td_error / 2, metrics

    by_option, _ = step_with(shaped(1.0), doubled)
    by_hand, _ = step_with(shaped(2.0)._replace(update=update), config)
    plain, _ = step_with(shaped(1.0), config)
    np.testing.assert_array_equal(by_option.replay.priority, by_hand.replay.priority)
    leaves = [jax.tree.leaves(states.agent.critic) for states in (by_option, by_hand, plain)]
    for a, b in zip(*leaves[:2], strict=True):
        np.testing.assert_array_equal(a, b)
    assert any((a != b).any() for a, b in zip(leaves[0], leaves[2], strict=True))


def test_a_method_that_learns_along_does_not_share_its_randomness_with_the_updates():
    config, sacfd = probe_env.config(), algorithms.load("sacfd")

    def number(key):
        return jax.random.key_data(key)[..., -1].astype(jnp.float32)

    def update(nets, agent, batch, key, config):
        agent, td_error, metrics = sacfd.update(nets, agent, batch, key, config)
        return agent, td_error, {**metrics, "number": number(key)}

    noting = sacfd._replace(
        prepare=lambda key, *_: jax.random.key_data(key),
        adapt=lambda prepared, buffer, draw, key, config: jax.random.key_data(key),
        update=update,
    )
    config = dataclasses.replace(config, sac=dataclasses.replace(config.sac, warmup_steps=0))
    after, metrics = step_with(noting, config, steps=1)
    adapt_key = jax.random.wrap_key_data(after.prepared[0])
    same = number(jax.random.split(adapt_key, config.sac.updates_per_step)).mean()
    assert metrics["number"][0] != same and metrics["number"][0] > 0


def test_nothing_is_learned_during_warmup():
    config = probe_env.config()
    learner, states = learner_and_states(config)
    before = jax.tree.map(np.asarray, states.agent)
    after, _ = chunk.make(learner, 4)(states, jnp.int32(0))
    for a, b in zip(jax.tree.leaves(before), jax.tree.leaves(after.agent), strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_is_stored_is_what_happened_before_any_reset():
    config = probe_env.config()
    learner, states = learner_and_states(config)
    after, _ = chunk.make(learner, 12)(states, jnp.int32(0))
    storage = jax.tree.map(lambda leaf: np.asarray(leaf)[0, 6 : 6 + 48], after.replay.storage)
    # The first entry counts steps, so it grows by one over every stored step, resets included.
    np.testing.assert_array_equal(storage.next_obs[:, 0], storage.obs[:, 0] + 1)
    np.testing.assert_array_equal(storage.next_obs[:, 1:], storage.obs[:, 1:])
    np.testing.assert_array_equal(storage.terminated, storage.action[:, 0] > 0)
    assert storage.terminated.any() and not storage.terminated.all()


def test_a_broken_simulation_is_counted_and_never_stored():
    config = probe_env.config()
    learner, states = learner_and_states(config, env=probe_env.make(breaks_at=0.5))
    after, metrics = chunk.make(learner, 12)(states, jnp.int32(0))
    assert (np.asarray(metrics["nonfinite"]) > 0).all()
    for leaf in jax.tree.leaves((after.agent, after.replay)):
        assert np.isfinite(np.asarray(leaf, np.float64)).all()
    stored = np.asarray(after.replay.priority)[:, 6 : 6 + 48] > 0
    assert stored.sum() == 3 * 48 - np.asarray(metrics["nonfinite"]).sum()


def test_demonstrations_stay_in_the_buffer():
    config = probe_env.config()
    learner, states = learner_and_states(config)
    demos = jax.tree.map(lambda leaf: np.asarray(leaf)[:, :6], states.replay.storage)
    after, _ = chunk.make(learner, 40)(states, jnp.int32(0))
    kept = jax.tree.map(lambda leaf: np.asarray(leaf)[:, :6], after.replay.storage)
    jax.tree.map(np.testing.assert_array_equal, demos, kept)


def test_rewards_are_those_of_the_judge_as_it_is_after_its_update():
    """Adapted once in each step of learning; a reward of a batch is how often that has been."""

    def update(nets, agent, batch, key, config):
        learned = {"least": batch.one_step.reward.min(), "most": batch.one_step.reward.max()}
        return agent, jnp.zeros(batch.one_step.reward.shape), learned

    method = algorithms.load("sacfd")._replace(
        prepare=lambda key, preparation, config: jnp.float32(0),
        adapt=lambda prepared, buffer, draw, key, config: prepared + 1,
        relabel=lambda prepared, buffer, draw, config: jnp.full(draw.rows.shape, prepared),
        update=update,
    )
    config = probe_env.config()
    learner = train_step.make(probe_env.make(), method, config)
    state = learner.init(jax.random.key(0), probe_env.preparation(6))
    first = warmup_steps(config)
    for times in (1, 2):
        state, metrics = learner.step(state, jnp.int32(first + times))
        assert metrics["least"] == metrics["most"] == times * config.sac.reward_scale


def test_demonstrations_that_only_fit_the_potential_are_never_drawn():
    config = dataclasses.replace(probe_env.config(), algorithm="crsfd")
    shares = {}
    for drawn in ("no", "yes"):
        replay = dataclasses.replace(config.replay, draw_demos=drawn)
        own = dataclasses.replace(config, replay=replay)
        learner, states = learner_and_states(own)
        fitted = jax.tree.map(np.asarray, states.prepared)
        after, metrics = chunk.make(learner, 40)(states, jnp.int32(0))
        shares[drawn] = np.asarray(metrics["demo_share"])
        assert (np.asarray(after.replay.priority)[:, :6] > 0).all() == (drawn == "yes")
        jax.tree.map(np.testing.assert_array_equal, fitted, after.prepared)
    assert (shares["no"] == 0).all() and (shares["yes"] > 0).all()


def test_sac_draws_uniformly_and_without_demonstrations():
    config = probe_env.config(algorithm="sac")
    learner, states = learner_and_states(config)
    after, metrics = chunk.make(learner, 12)(states, jnp.int32(0))
    weight = np.asarray(after.replay.priority)
    assert set(np.unique(weight)) <= {0.0, 1.0}
    assert (np.asarray(metrics["demo_share"]) == 0).all()


def test_methods_differ_only_in_their_rewards_and_buffer():
    """CRSfD with a potential that is zero everywhere learns exactly as SACfD does."""
    config = probe_env.config()
    learner, states = learner_and_states(config)
    plain, _ = chunk.make(learner, 16)(states, jnp.int32(0))
    config = dataclasses.replace(config, algorithm="crsfd")
    learner, states = learner_and_states(config)
    fitted = jax.tree.map(jnp.zeros_like, states.prepared)
    fitted = jax.tree_util.tree_map_with_path(_minus_infinity_at_the_output, fitted)
    shaped, _ = chunk.make(learner, 16)(states.replace(prepared=fitted), jnp.int32(0))
    for a, b in zip(jax.tree.leaves(plain.agent), jax.tree.leaves(shaped.agent), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)


def _minus_infinity_at_the_output(path, leaf):
    is_output_bias = "Dense_2" in jax.tree_util.keystr(path) and leaf.shape[-1] == 1
    return jnp.full_like(leaf, -100.0) if is_output_bias and leaf.ndim == 2 else leaf


@pytest.mark.parametrize("algorithm", ["sac", "sacfd", "crsfd", "rlpd", "pofd", "gaifo", "sqil"])
def test_the_probe_is_learned(algorithm):
    probe_env.assert_learned(*learner_and_states(probe_env.eager_config(algorithm)))
