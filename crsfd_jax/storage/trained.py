"""The trained policies of a run, read back from its folder."""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.learn.networks import Networks, Params, make_networks
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.storage import artefacts, metrics, policy, run_folder


class Trained(NamedTuple):
    """The policies of all seeds of a run."""

    config: Config
    nets: Networks
    actors: Params
    """[S, ...] each."""


class Chosen(NamedTuple):
    """One seed of a run and how it did in the newest evaluation."""

    index: int
    """Position among the seeds of the run."""
    seed: int
    success: float
    episodes: int
    env_steps: int


def load(run: str | Path) -> Trained:
    """Reads the policies of a run.

    Raises:
      UserError: the folder holds no run, or its policies are missing or damaged.
    """
    config, file = artefacts.read_config(run), run_folder.at(run).policy
    if not file.exists():
        raise UserError(f"{run}: has no policy yet, expected {file.name}; let it train on")
    nets = make_networks(config.sac, ACTION_SIZE)

    def start(key):
        return nets.actor.init(key, jnp.zeros(OBS_SIZE))

    def start_all():
        return jax.vmap(start)(jax.random.split(jax.random.key(0), config.seeds))

    return Trained(config, nets, policy.load(file, jax.eval_shape(start_all)))


def choose(run: str | Path, config: Config, wanted: str) -> Chosen:
    """The seed of a number, or the best: most successes, then fewest steps, then lowest number.

    Raises:
      UserError: the run has no such seed, or no evaluation yet.
    """
    table = metrics.read(run_folder.at(run).metrics)
    if not len(table["env_steps"]):
        raise UserError(f"{run}: has no evaluation yet; let it train on")
    newest = table["env_steps"] == table["env_steps"].max()
    last = {name: column[newest] for name, column in table.items()}
    names = [str(seed) for seed in last["seed"]]
    if wanted not in ("best", *names):
        allowed = ", ".join(("best", *names))
        raise UserError(f"--seed: got {wanted!r}, allowed: {allowed}; choose one of them")
    order = np.lexsort((last["seed"], last["eval/episode_length"], -last["eval/success_rate"]))
    row = int(order[0]) if wanted == "best" else names.index(wanted)
    seed = int(last["seed"][row])
    return Chosen(
        index=seed - config.seed,
        seed=seed,
        success=float(last["eval/success_rate"][row]),
        episodes=int(last["eval/episodes"][row]),
        env_steps=int(last["env_steps"][row]),
    )


def actor(policies: Trained, chosen: Chosen) -> Params:
    """The parameters of one seed's policy."""
    return jax.tree.map(lambda leaf: leaf[chosen.index], policies.actors)
