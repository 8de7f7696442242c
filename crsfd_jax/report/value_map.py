"""Pictures of the potential that shapes CRSfD's rewards, with the demonstrations drawn in."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from crsfd_jax import shown_potential
from crsfd_jax.config import Config
from crsfd_jax.drawing.axes import clean
from crsfd_jax.report.cells import Cell
from crsfd_jax.report.figures import save
from crsfd_jax.scene.digits import HOLE_DEPTH
from crsfd_jax.shown_potential import Phi

SHIFTS_MM = (4, 6, 8)
_SIDE, _LOW, _HIGH = 0.03, -0.035, 0.075
"""m, half width of the pictures, and their lowest and highest point."""
_PIXELS = 121
_LEVELS = np.linspace(0, 1, 21)


def draw_of(cells: Sequence[Cell], path: Path) -> str:
    """Draws the potential of CRSfD's usual runs among cells, or of any, or of default options.

    Of several, that of the largest shift; beside it, if its demonstrations are moved about, the
    one that is fitted where they are.

    Returns:
      What the picture shows, in words.

    Raises:
      UserError: their demonstrations cannot be used.
    """
    ours = [cell for cell in cells if cell.method == "crsfd"]
    ours.sort(key=lambda cell: (bool(cell.variant), -cell.task.shift_mm))
    config = ours[0].runs[0].manifest.config if ours else Config()
    phi, demos = shown_potential.fit(config)
    spread, nominal, beside = config.potential.spread, None, ""
    if config.shift if spread is None else spread:
        at_nominal = dataclasses.replace(config.potential, spread=0.0)
        nominal, _ = shown_potential.fit(dataclasses.replace(config, potential=at_nominal))
        beside = " In the middle and dashed: fitted where the demonstrations are, as in the paper."
    gamma = config.sac.gamma
    draw(phi, demos, nominal, path)
    also = f"{rewarded(nominal, demos, gamma):.0%} with the dashed potential, " if nominal else ""
    return (
        "The potential that shapes the rewards, fitted as in training with a shift of "
        f"{config.shift * 1e3:g} mm, for a tip at rest in the frame of the nominal socket.{beside} "
        "Orange: tip of the demonstrations, seen from above and from the side, with a dot at the "
        "end. Squares: where the socket's centre may lie at shifts of 4, 6 and 8 mm. Hatched: out "
        "of reach whichever of them it is. Of the demonstrated steps "
        f"{rewarded(phi, demos, gamma):.0%} earn a positive shaping reward with gamma_k {gamma:g}, "
        f"{also}and {rewarded(nominal or phi, demos, config.potential.gamma):.0%} with gamma_k as "
        f"low as gamma_0, {config.potential.gamma:g}."
    )


def rewarded(phi: Phi, demos: np.ndarray, gamma: float) -> float:
    """Share of the demonstrated steps with gamma Phi(s') - Phi(s) above 0 (Guo et al., theorem 1).

    Args:
      demos: [K, T, 6] tip poses, as from `shown_potential.tracks`.
    """
    values = phi(demos)
    gained = gamma * values[:, 1:] - values[:, :-1]
    return float((gained > 0).sum() / np.isfinite(gained).sum())


def draw(phi: Phi, demos: np.ndarray, nominal: Phi | None, path: Path) -> None:
    """Writes the socket plane, a vertical cut and three profiles as PNG.

    Args:
      demos: [K, T, 6] tip poses, as from `shown_potential.tracks`.
      nominal: the potential of the nominal place, to compare with, if it is another.
    """
    shown = {"": (phi, "-")}
    if nominal:
        shown = {
            "averaged over the places of the socket": (phi, "-"),
            "fitted at the nominal place alone": (nominal, "--"),
        }
    canvas = matplotlib.figure.Figure((14, 7.4), layout="constrained")
    halves: Any = canvas.subfigures(2, 1, height_ratios=(1.75, 1))
    above = halves[0].subplots(1, len(shown) + 1)
    for axes, (label, (each, _)) in zip(above, shown.items(), strict=False):
        _draw_plane(axes, each, demos, f"plane of the mouth\n{label}".rstrip())
    colours = _draw_cut(above[-1], phi, demos)
    ticks = np.linspace(0, 1, 6)
    halves[0].colorbar(colours, ax=above.tolist(), label="potential", shrink=0.9, ticks=ticks)
    profiles = halves[1].subplots(1, len(PROFILES), sharey=True)
    for axes, (title, unit, along) in zip(profiles, PROFILES, strict=True):
        for label, (each, dashes) in shown.items():
            _draw_profile(axes, each, along, dashes, label)
        axes.set_title(title, fontsize=10.5)
        axes.set_xlabel(unit, fontsize=10)
    profiles[0].set_ylabel("potential", fontsize=10)
    if nominal:
        profiles[1].legend(frameon=False, fontsize=9.5)
    save(canvas, path)


def _line(axis: int, low: float, high: float) -> np.ndarray:
    """Poses [N, 6] along one axis through the mouth, upright but for that axis."""
    poses = np.zeros((201, 6))
    poses[:, axis] = np.linspace(low, high, len(poses))
    return poses


PROFILES = (
    ("along x, at the mouth", "x, mm", (1e3, 0, _line(0, -_SIDE, _SIDE))),
    ("along z, on the axis", "z above the mouth, mm", (1e3, 2, _line(2, _LOW, _HIGH))),
    ("tilted about x, at the mouth", "tilt, degrees", (180 / np.pi, 3, _line(3, -0.15, 0.15))),
)
"""Title, unit and (factor to it, axis, poses) of the small plots."""


def _grid(across: np.ndarray, axis: int, up: np.ndarray) -> np.ndarray:
    """Upright poses [len(up), len(across), 6]: x along columns, another axis along rows."""
    poses = np.zeros((len(up), len(across), 6))
    poses[..., 0], poses[..., axis] = across[None, :], up[:, None]
    return poses


def _draw_plane(axes: Axes, phi: Phi, demos: np.ndarray, title: str) -> None:
    side = np.linspace(-_SIDE, _SIDE, _PIXELS)
    values = phi(_grid(side, 1, side))
    axes.contourf(side * 1e3, side * 1e3, values, _LEVELS, cmap="Blues")
    _draw_tracks(axes, demos, 1)
    for shift in SHIFTS_MM:
        axes.add_patch(
            Rectangle((-shift / 2, -shift / 2), shift, shift, fill=False, edgecolor="k", lw=0.9)
        )
    axes.annotate(
        "socket offsets: 4, 6, 8 mm squares", (4, -4), (27, -27), ha="right", fontsize=8.5,
        arrowprops={"arrowstyle": "-", "lw": 0.7}, bbox=_PAPER,
    )  # fmt: skip
    _finish(axes, title, "y, mm")


def _draw_cut(axes: Axes, phi: Phi, demos: np.ndarray):
    side, up = np.linspace(-_SIDE, _SIDE, _PIXELS), np.linspace(_LOW, _HIGH, _PIXELS)
    shown = axes.contourf(side * 1e3, up * 1e3, phi(_grid(side, 2, up)), _LEVELS, cmap="Blues")
    _draw_tracks(axes, demos, 2)
    axes.axhline(0, color="k", linewidth=0.9)
    axes.axhline(-HOLE_DEPTH * 1e3, color="k", linewidth=0.9, linestyle="--")
    reach = (max(SHIFTS_MM) + 1) / 2
    for left in (-_SIDE * 1e3, reach):
        corner, width = (left, _LOW * 1e3), _SIDE * 1e3 - reach
        axes.add_patch(Rectangle(corner, width, -_LOW * 1e3, color="0.93", alpha=0.85, hatch="//"))
    axes.text(17, -18, "inside the socket:\nout of reach", fontsize=8.5, ha="center", bbox=_PAPER)
    axes.text(-29, 1, "mouth", fontsize=8.5, bbox=_PAPER)
    axes.text(-29, -HOLE_DEPTH * 1e3 + 1, "bottom", fontsize=8.5, bbox=_PAPER)
    _finish(axes, "cut at y = 0", "z above the mouth, mm")
    return shown


_PAPER = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.5}


def _draw_tracks(axes: Axes, demos: np.ndarray, axis: int) -> None:
    for track in demos * 1e3:
        axes.plot(track[:, 0], track[:, axis], color="#D55E00", linewidth=0.7, alpha=0.55)
    ends = np.array([track[np.isfinite(track[:, 0])][-1] for track in demos]) * 1e3
    axes.plot(ends[:, 0], ends[:, axis], "o", color="#8F3F00", markersize=2.2)


def _finish(axes: Axes, title: str, vertical: str) -> None:
    axes.set_title(title, fontsize=10.5)
    axes.set_xlabel("x, mm", fontsize=10)
    axes.set_ylabel(vertical, fontsize=10)
    axes.set_xlim(-_SIDE * 1e3, _SIDE * 1e3)
    bounds = (-_SIDE, _SIDE) if vertical.startswith("y") else (_LOW, _HIGH)
    axes.set_ylim(bounds[0] * 1e3, bounds[1] * 1e3)
    axes.tick_params(labelsize=9)


def _draw_profile(axes: Axes, phi: Phi, along, dashes: str, label: str) -> None:
    factor, axis, poses = along
    (line,) = axes.plot(poses[:, axis] * factor, phi(poses), dashes, label=label)
    line.set(color="#0072B2", linewidth=2)
    clean(axes)
    axes.set_ylim(0, 1.03)
