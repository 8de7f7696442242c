"""Success rate of the policies of a run, with its interval, by seed and by shape."""

import dataclasses
from pathlib import Path

import jax
import numpy as np

from crsfd_jax import evaluation, task
from crsfd_jax.config import Config
from crsfd_jax.intervals import rate_interval
from crsfd_jax.options import shapes
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.storage import trained, trials
from crsfd_jax.storage.trained import Trained
from crsfd_jax.training import divergence


def report(run: Path, config: Config, episodes: int, seed: int, table: str, asked: str) -> None:
    """Prints a line for each seed, for each shape if there are several, and for all of them.

    Args:
      run: folder of the trained policies.
      config: options of the run, with the task to play.
      episodes: of each seed, which begin from `seed`.
      table: file to write a row for each seed and shape to; none if empty.
      asked: the options behind all this, which the table records.

    Raises:
      UserError: the folder holds no policies of these options, or the file cannot be written.
    """
    policies = trained.load(run)
    lost = divergence.find(policies.actors, {})
    played = _play(policies, config, episodes, seed)
    success, length = np.asarray(played.success), np.asarray(played.length)
    row, known = np.asarray(played.shape), task.shapes_known(config)
    chosen = [known.index(shape) for shape in shapes.read(config.shape)]
    print(_describe(config))
    for i in range(config.seeds):
        line = _line(success[i : i + 1], length[i : i + 1])
        print(f"seed {config.seed + i:<8d} {line}{', diverged in training' * (i in lost)}")
    for shape in (s for s in chosen if len(chosen) > 1 and (row == s).any()):
        print(f"shape {shapes.label(known[shape]):<7s} {_line(success, length, row == shape)}")
    print(f"all           {_line(success, length)}")
    if table:
        rows = [
            trials.Row(config.seed + i, shapes.label(known[shape]), at.sum(), won[at].sum(), asked)
            for i, won in enumerate(success)
            for shape in chosen
            for at in [row[i] == shape]
        ]
        trials.write(Path(table), rows, "--csv")


def _play(policies: Trained, config: Config, episodes: int, seed: int) -> evaluation.Episodes:
    env = task.make_env(config)
    keys = jax.random.split(jax.random.key(seed), config.seeds)

    def play(actor, key):
        return evaluation.run(env, policies.nets, actor, key, episodes)

    return jax.jit(jax.vmap(play))(policies.actors, keys)


def _describe(config: Config) -> str:
    names = (field.name for field in dataclasses.fields(Randomisation))
    drawn = [
        f"{name.replace('_', ' ')} {' '.join(f'{v:g}' for v in np.atleast_1d(value))}"
        for name in names
        if (value := getattr(config.randomisation, name)) != getattr(Randomisation(), name)
    ]
    what = f"shape {shapes.label(config.shape)}, shift {config.shift * 1e3:g} mm"
    return ", ".join([what, *drawn, "deterministic policy"])


def _line(success: np.ndarray, length: np.ndarray, where: np.ndarray | bool = True) -> str:
    """What episodes [S, E] of seeds came to, of those at `where`."""
    counted = np.broadcast_to(where, success.shape)
    won, played = (success & counted).sum(axis=1), counted.sum(axis=1)
    low, high = rate_interval(won, played)
    return (
        f"success {won.sum() / played.sum():.3f}, 95 % interval {low:.3f} to {high:.3f} "
        f"({won.sum()} of {played.sum()}), {length[counted].mean():.1f} steps on average"
    )
