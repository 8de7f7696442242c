"""Where do trained policies find a moved hole, where do they look for it, how hard do they push?

Hypothesis: a potential draws the peg back to the nominal place, so that CRSfD misses the far
corners of the square more often than SACfD does.

    python experiments/studies/search.py search.png \\
        runs/setting2/crsfd-shape2-shift8mm-seed0x5 runs/setting2/sacfd-shape2-shift8mm-seed0x5

For each run, from its shift: success by the distance of the hole from its nominal place, the share
of steps on the plate and the push there, where the plate is touched first, a map of success over
where the hole is, and of where the tip is while it touches the plane of the mouth. What came out
is in docs/when_shaping_helps.md.
"""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.figure
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from crsfd_jax import cli, compile_cache, task
from crsfd_jax.errors import UserError
from crsfd_jax.learn.networks import mode_action
from crsfd_jax.observation import SCALE
from crsfd_jax.options import shapes
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.physics.interface import Surroundings
from crsfd_jax.report.methods import style
from crsfd_jax.storage import trained

EPISODES = 1000
"""Of each seed."""
TOUCHES = 1.5e-3
"""m above the mouth or below it: the tip is on the plate."""
BINS = 6
STIFFNESS, STRONGEST = 1000.0, 10.0
"""N/m and N, of the controller along z (mjcf/insertion.xml)."""


class Played(NamedTuple):
    """Whole episodes of S seeds."""

    around: Surroundings
    """[S, K]."""
    success: np.ndarray
    """[S, K]."""
    tip: np.ndarray
    """[S, T, K, 3] m, NaN once an episode is over."""
    push: np.ndarray
    """[S, T, K] N, downwards, that the controller asks for."""


def play(policies: trained.Trained, arm: Randomisation | None = None) -> Played:
    """Plays the policies of a run.

    Args:
      arm: what is drawn in place of the run's own.
    """
    drawn = policies.config.randomisation if arm is None else arm
    env = task.make_env(dataclasses.replace(policies.config, randomisation=drawn))

    def one(actor, key) -> Any:
        start = env.reset(key, EPISODES)

        def body(carry, _):
            state, running = carry
            state, outcome = env.advance(state, mode_action(policies.nets.actor, actor, state.obs))
            over = outcome.terminated | ~outcome.finite
            tip = jnp.where(running[:, None], outcome.tip[:, :3], jnp.nan)
            # The last column: how far the setpoint is above the tip.
            push = jnp.clip(-STIFFNESS * SCALE[-1] * outcome.next_obs[:, -1], 0.0, STRONGEST)
            return (state, running & ~over), (tip, push, running & outcome.terminated)

        carry = start, jnp.ones(EPISODES, bool)
        _, (tip, push, success) = jax.lax.scan(body, carry, length=env.horizon)
        return start.around, success.any(axis=0), tip, push

    keys = jax.random.split(jax.random.key(2_000_000), policies.config.seeds)
    return Played(*jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(policies.actors, keys)))


def by_distance(offset: np.ndarray, success: np.ndarray, half: float) -> list[float]:
    """Success in four rings of equal width around the nominal place, squares as the shift is."""
    ring = np.minimum(np.abs(offset).max(axis=-1) / half * 4, 3.999).astype(int)
    return [float(success[ring == i].mean()) for i in range(4)]


def where_found(offset: np.ndarray, success: np.ndarray, half: float) -> np.ndarray:
    """[BINS, BINS] success over where the hole is, x first."""
    edges = np.linspace(-half, half, BINS + 1)
    x, y = offset.reshape(-1, 2).T
    found = np.histogram2d(x, y, (edges, edges), weights=success.ravel().astype(float))[0]
    return found / np.histogram2d(x, y, (edges, edges))[0]


def touching(tip: np.ndarray) -> np.ndarray:
    """[...] bool, whether tips [..., 3] are on the plate; not once an episode is over."""
    return np.abs(tip[..., 2]) < TOUCHES


def where_touched(tip: np.ndarray, half: float) -> np.ndarray:
    """[48, 48] density of the tip on the plate within twice the shift, x first."""
    x, y, _ = tip[touching(tip)].T
    edges = np.linspace(-2 * half, 2 * half, 49)
    return np.histogram2d(x, y, (edges, edges), density=True)[0]


def first_touch(tip: np.ndarray) -> tuple[float, float]:
    """Of the first touches of a seed: how far from the nominal place their middle is, and how far
    from that middle they are, m, root of the mean square; mean of both over the seeds."""
    on_plate = touching(tip)
    first = on_plate.argmax(axis=1)
    at = np.take_along_axis(tip[..., :2], first[:, None, :, None], axis=1)[:, 0]
    touched = np.asarray(on_plate.any(axis=1))
    places = np.where(touched[..., None], at, np.nan)
    middle = np.nanmean(places, axis=1, keepdims=True)
    apart = np.sqrt(np.nanmean(np.sum((places - middle) ** 2, axis=-1), axis=1))
    return float(np.linalg.norm(middle, axis=-1).mean()), float(apart.mean())


class Found(NamedTuple):
    """What is drawn of a run."""

    label: str
    half_mm: float
    """Half the side of the square in which the hole lies."""
    found: np.ndarray
    touched: np.ndarray


def draw(found: list[Found], path: Path) -> None:
    """Two rows of maps, a column for each run; a row has one scale of colours."""
    figure = matplotlib.figure.Figure((2.4 * len(found) + 1.2, 5.6), layout="constrained")
    rows = figure.subplots(2, len(found), squeeze=False)
    # A policy that rests on one spot would leave the rest of its map dark.
    most = np.quantile([each.touched for each in found], 0.995)
    for column, each in zip(rows.T, found, strict=True):
        over = draw_map(column[0], each.found, each.half_mm, 0.5, 1.0)
        on = draw_map(column[1], each.touched, 2 * each.half_mm, 0.0, most)
        corner, side = (-each.half_mm, -each.half_mm), 2 * each.half_mm
        column[1].add_patch(Rectangle(corner, side, side, fill=False, edgecolor="w", lw=1))
        column[0].set_title(each.label, fontsize=10.5)
    figure.colorbar(over, ax=rows[0].tolist(), label="success by place of the hole", extend="min")
    label = "where the tip touches the plate"
    bar = figure.colorbar(on, ax=rows[1].tolist(), label=label, extend="max")
    bar.set_ticks([0, most], labels=["never", "often"])
    for axis in rows[:, 0]:
        axis.set_ylabel("y, mm")
    for axis in rows[1]:
        axis.set_xlabel("x, mm")
    figure.savefig(path, dpi=130)


def draw_map(axis: Axes, values: np.ndarray, half_mm: float, low: float, high: float):
    """A map of values over the plane of the mouth."""
    extent = (-half_mm, half_mm, -half_mm, half_mm)
    axis.set_xticks([-half_mm, 0, half_mm])
    axis.set_yticks([-half_mm, 0, half_mm])
    return axis.imshow(values.T, origin="lower", extent=extent, vmin=low, vmax=high)


@dataclasses.dataclass(frozen=True)
class Search:
    """Where trained policies find a moved hole, and where they look for it."""

    picture: tyro.conf.Positional[Path]
    """PNG to draw."""
    run: tyro.conf.Positional[Path]
    """Folder of a run with a shift."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them."""


def main(argv: list[str]) -> None:
    """Prints a line for each run and draws two maps of each."""
    options = cli.parse(Search, argv)
    if not options.picture.absolute().parent.is_dir():
        raise UserError(f"{options.picture}: allowed: a folder that exists; make it first")
    compile_cache.enable()
    shown = []
    for run in (options.run, *options.others):
        policies = trained.load(run)
        config = policies.config
        half = config.shift / 2
        if not half:
            raise UserError(f"{run}: its hole does not move; choose a run with a --shift")
        played = play(policies)
        offset = np.asarray(played.around.socket_offset)
        words = " ".join(f"{rate:.3f}" for rate in by_distance(offset, played.success, half))
        on_plate = touching(played.tip)
        share = on_plate.sum() / np.isfinite(played.tip[..., 2]).sum()
        off, apart = first_touch(played.tip)
        print(
            f"{run.name}: success {played.success.mean():.3f}, from the nominal place outwards "
            f"{words}; on the plate in {share:.2f} of the "
            f"steps, with {played.push[on_plate].mean():.1f} N; first touches around a place "
            f"{off * 1e3:.1f} mm off, {apart * 1e3:.1f} mm apart"
        )
        where = where_found(offset, played.success, half), where_touched(played.tip, half)
        label = f"{style(config.algorithm).label}, shape {shapes.label(config.shape)}"
        shown.append(Found(label, half * 1e3, *where))
    draw(shown, options.picture)
    print(options.picture)


if __name__ == "__main__":
    cli.main(main)
