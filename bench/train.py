"""Wall time of a whole run by part, as one JSON line.

Each part is compiled alone and timed on the states of the run itself, after warm-up; the whole
run is the sum over its chunks and evaluations. `rest` is what a chunk takes beyond its physics
and updates: acting, storing, keys.
"""

import functools
import json
import time

import jax
import jax.numpy as jnp

from crsfd_jax import algorithms, cli, compile_cache, task
from crsfd_jax.config import Config
from crsfd_jax.demos import builtin
from crsfd_jax.options import schedule
from crsfd_jax.options.schedule import CHUNK_STEPS
from crsfd_jax.storage import manifest
from crsfd_jax.training import devices, train_step
from crsfd_jax.training.program import build, compiled, fitted

ROUNDS = 5


def timed(function, *arguments) -> float:
    """Seconds of the fastest of a few calls; the first one is not counted."""
    jax.block_until_ready(function(*arguments))
    rounds = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        rounds.append(time.perf_counter() - began)
    return min(rounds)


def measure(config: Config) -> dict:
    """Seconds of each part of a run with this configuration."""
    program = build([config], builtin.load(config.demos))
    began = time.perf_counter()
    states = jax.block_until_ready(program.start(program.own))
    prepared = time.perf_counter() - began
    began = time.perf_counter()
    program, own = compiled(program, states), program.own
    compile_s = time.perf_counter() - began
    warm = -(-schedule.warmup_steps(config) // CHUNK_STEPS) + 1
    for i in range(warm):
        states, _ = program.advance(states, own, jnp.int32(i * CHUNK_STEPS))
    began = time.perf_counter()
    for i in range(warm, warm + ROUNDS):
        states, _ = program.advance(states, own, jnp.int32(i * CHUNK_STEPS))
    jax.block_until_ready(states.key)
    chunk = (time.perf_counter() - began) / ROUNDS

    env, method = task.make_env(config), algorithms.load(config.algorithm)
    nets = train_step.make(env, method, config).nets
    update = functools.partial(train_step.learn, nets, method, method.configure(config))

    def physics(envs, keys):
        def body(envs, keys):
            action = jax.vmap(lambda k: jax.random.uniform(k, (config.envs, 6), minval=-1.0))(keys)
            return jax.vmap(env.step)(envs, action, keys)[0], None

        return jax.lax.scan(body, envs, keys)[0]

    def updates(states, keys):
        def body(states, keys):
            step = jnp.int32(warm * CHUNK_STEPS)
            return jax.vmap(update, in_axes=(0, None, 0))(states, step, keys)[0], None

        return jax.lax.scan(body, states, keys)[0].agent

    keys = jax.random.split(jax.random.key(0), (CHUNK_STEPS, config.seeds))
    physics_s = timed(jax.jit(physics), states.env, keys)
    updates_s = timed(jax.jit(updates), states, keys)
    evaluation_s = timed(program.evaluate, states.agent.average_actor, own, jnp.int32(0))
    total = schedule.total_steps(config)
    chunks, evaluations = total // CHUNK_STEPS, -(-total // schedule.evaluation_period(config))
    parts = {
        "prepare_s": prepared,
        "compile_s": compile_s,
        "physics_s": chunks * physics_s,
        "updates_s": chunks * updates_s,
        "rest_s": chunks * (chunk - physics_s - updates_s),
        "evaluation_s": evaluations * evaluation_s,
    }
    return {name: round(value, 2) for name, value in parts.items()} | {
        "total_s": round(sum(parts.values()), 1),
        "env_steps_per_second": round(CHUNK_STEPS * config.envs * config.seeds / chunk),
    }


def run(argv: list[str]) -> int:
    """Measures the run that a training command line describes."""
    compile_cache.enable()
    config = fitted(cli.parse(Config, argv))
    line = {
        "bench": "train",
        "algorithm": config.algorithm,
        "seeds": config.seeds,
        "steps": config.steps,
        "device": devices.describe(config),
        **measure(config),
        "versions": manifest.versions(),
    }
    print(json.dumps(line))
    return 0


if __name__ == "__main__":
    cli.main(run)
