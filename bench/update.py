"""Time of one gradient update, with sampling and re-prioritising, as one JSON line.

Everything runs as in training: vmapped seeds in a jitted scan with donated state, a full buffer.
Three programs are timed in turn, and the best of their rounds counts: whole vector steps, the
same without the updates (sampling, re-prioritising, adding), and bare matrix products of the
shapes of an update.
"""

import dataclasses
import functools
import itertools
import json
import time
from collections.abc import Callable
from importlib import metadata

import flax
import jax
import jax.numpy as jnp
import tyro

from crsfd_jax import config
from crsfd_jax.learn import networks, replay, sac
from crsfd_jax.types import Transition

DEMOS = 720


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    seeds: tuple[int, ...] = (1, 5)
    """Numbers of seeds to measure, one after the other."""
    obs_size: int = 29
    """Observation size."""
    action_size: int = 6
    """Action size."""
    envs: int = 64
    """Environments of each seed."""
    steps: int = 2
    """Vector steps in a timed call."""
    rounds: int = 8
    """Timed calls of each program; the fastest counts."""
    sac: config.Sac = dataclasses.field(default_factory=config.Sac)
    replay: config.Replay = dataclasses.field(default_factory=config.Replay)


def random_transitions(options: Options, key: jax.Array, count: int) -> Transition:
    """Transitions [count] with the shapes and the episode length of training."""
    obs = jax.random.normal(key, (2, count, options.obs_size))
    return Transition(
        obs=obs[0],
        action=jnp.tanh(obs[0, :, : options.action_size]),
        reward=jnp.zeros(count),
        next_obs=obs[1],
        terminated=jnp.zeros(count, bool),
        truncated=jnp.arange(count) % 50 == 49,
    )


def full_buffer(options: Options, key: jax.Array) -> replay.ReplayState:
    """A buffer whose rows all have a priority."""
    state = replay.init(random_transitions(options, key, DEMOS), options.envs, options.replay)
    rows = state.storage.reward.shape[0]
    leaves = jax.random.uniform(key, (rows,), minval=0.01)
    return dataclasses.replace(state, priority=state.priority.at[:rows].set(leaves))


def vector_step(options: Options, with_updates: bool) -> Callable:
    """The learning half of a training step of one seed: (state, step, key) -> state."""
    run = config.Config(sac=options.sac, replay=options.replay)
    nets = networks.make_networks(options.sac, options.action_size)
    shape = (options.sac.updates_per_step, options.sac.batch_size)

    def update(agent, inputs):
        agent, td_error, _ = sac.update(nets, agent, inputs[0], inputs[1], run)
        return agent, td_error

    def step_seed(state, step, key):
        buffer, agent = state
        new_key, draw_key, update_key = jax.random.split(key, 3)
        new = random_transitions(options, new_key, options.envs)
        buffer = replay.add(buffer, new, jnp.ones(options.envs, bool), step)
        draw = replay.draw(buffer, step, draw_key, shape, options.replay)
        rewards = buffer.storage.reward[draw.rows]
        batches = replay.gather(buffer, draw, rewards, options.sac.gamma)
        if with_updates:
            keys = jax.random.split(update_key, shape[0])
            agent, td_error = jax.lax.scan(update, agent, (batches, keys))
        else:
            td_error = _touch(batches)
        return replay.reprioritise(buffer, draw, td_error, options.replay), agent

    return step_seed


def _touch(batches: replay.Batch) -> jax.Array:
    """Something [U, B] that needs every number of the batches, so that none is optimised away."""
    leaves = [jnp.asarray(leaf, jnp.float32) for leaf in jax.tree.leaves(batches)]
    return sum((leaf.sum(-1) if leaf.ndim == 3 else leaf for leaf in leaves), jnp.zeros(()))


def learner(options: Options, num_seeds: int, with_updates: bool) -> Callable[[], None]:
    """A call that runs `options.steps` vector steps of all seeds."""
    keys = jax.random.split(jax.random.key(0), num_seeds)
    run = config.Config(sac=options.sac, replay=options.replay)
    nets = networks.make_networks(options.sac, options.action_size)
    step_seeds = jax.vmap(vector_step(options, with_updates), in_axes=(0, None, 0))

    @functools.partial(jax.jit, donate_argnums=0)
    def chunk(state, first):
        def body(state, step):
            return step_seeds(
                state, step, jax.vmap(jax.random.fold_in, (0, None))(keys, step)
            ), None

        return jax.lax.scan(body, state, first + jnp.arange(options.steps))[0]

    @jax.jit
    @jax.vmap
    def start(key):
        return full_buffer(options, key), sac.init(nets, options.obs_size, key, run)

    held = [start(keys), 0]

    def call():
        held[0] = jax.block_until_ready(chunk(held[0], held[1]))
        held[1] += options.steps

    return call


def products(options: Options, num_seeds: int) -> Callable[[], None]:
    """A call that runs only the matrix products of as many updates as `learner`."""
    widths = options.sac.hidden
    actor = _layers((options.obs_size, *widths, 2 * options.action_size))
    critic = _layers((options.obs_size + options.action_size, *widths, 1))
    rows = options.sac.batch_size
    horizons = 2 if options.replay.n_step_weight > 0 else 1
    # Forward, input gradient and weight gradient of a layer are three products of equal size.
    passes = [(actor, 1, horizons, 1), (critic, 2, horizons, 1), (critic, 2, 1, 3)]
    passes += [(actor, 1, 1, 3), (critic, 2, 1, 2)]
    operands = []
    for layers, members, many, repeats in passes:
        for fan_in, fan_out in layers:
            left = jnp.ones((num_seeds, members, many * rows, fan_in))
            operands += [(left, jnp.ones((num_seeds, members, fan_in, fan_out)))] * repeats

    @jax.jit
    def chunk(operands):
        def body(scale, _):
            # The carried scale keeps the products inside the loop.
            ends = [((left * scale) @ right)[..., :1, :1].sum() for left, right in operands]
            return 1.0 + 1e-30 * sum(ends), None

        length = options.steps * options.sac.updates_per_step
        return jax.lax.scan(body, jnp.ones(()), length=length)[0]

    return lambda: jax.block_until_ready(chunk(operands))


def _layers(sizes: tuple[int, ...]) -> list[tuple[int, int]]:
    return list(itertools.pairwise(sizes))


def best_times(calls: list[Callable[[], None]], rounds: int) -> list[float]:
    """Fastest time of each call in seconds; they take turns, so that a busy machine is fair."""
    best = [float("inf")] * len(calls)
    for call in calls:
        call()
    for _ in range(rounds):
        for i, call in enumerate(calls):
            begin = time.perf_counter()
            call()
            best[i] = min(best[i], time.perf_counter() - begin)
    return best


def measure(options: Options, num_seeds: int) -> dict[str, float]:
    """Milliseconds per update of one seed, and what they consist of."""
    calls = [
        learner(options, num_seeds, with_updates=True),
        learner(options, num_seeds, with_updates=False),
        products(options, num_seeds),
    ]
    scale = 1e3 / (options.steps * options.sac.updates_per_step * num_seeds)
    whole, sampling, bare = (scale * seconds for seconds in best_times(calls, options.rounds))
    return {
        "ms_per_update_per_seed": round(whole, 4),
        "sampling_share": round(sampling / whole, 4),
        "matrix_product_limit_ms": round(bare, 4),
    }


def main() -> None:
    """Measures and prints the line."""
    options = tyro.cli(Options, description=__doc__)
    line = {
        "bench": "update",
        "device": jax.devices()[0].device_kind,
        "jax": jax.__version__,
        "jaxlib": metadata.version("jaxlib"),
        "flax": flax.__version__,
        "batch_size": options.sac.batch_size,
        "hidden": options.sac.hidden,
        "capacity": options.replay.capacity,
        "updates_per_step": options.sac.updates_per_step,
        "seeds": {str(count): measure(options, count) for count in options.seeds},
    }
    print(json.dumps(line))


if __name__ == "__main__":
    main()
