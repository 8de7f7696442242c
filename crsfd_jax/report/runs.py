"""Finds runs in folders and reads them; what is no run, or is damaged, is named and left out."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from crsfd_jax.config import to_dict
from crsfd_jax.curve import Curve, curve
from crsfd_jax.drawing import video
from crsfd_jax.errors import UserError
from crsfd_jax.options.names import by_full_name
from crsfd_jax.storage import manifest, metrics, run_folder
from crsfd_jax.storage.manifest import Manifest
from crsfd_jax.training import troubles

SUCCESS = "eval/success_rate"
EXPLORING = "train/success_rate"
EPISODES = "train/episodes"
_FOREIGN = ("checkpoints", "report", "__pycache__")
"""Folders in which no run is looked for."""


class Exploring(NamedTuple):
    """Episodes of training since the start, in which the policy explores, at each evaluation."""

    successes: Curve
    episodes: Curve


class Run(NamedTuple):
    """One run, finished or not."""

    name: str
    """Where it was found, as short as tells it apart."""
    described: Path
    """Its config.json, or NAME.json."""
    manifest: Manifest
    """What that says."""
    curve: Curve
    """Success of each seed against environment steps."""
    exploring: Exploring
    seeds: np.ndarray
    """[S] seeds of the columns of `curve`, ascending."""
    wall_s: float
    """Time spent in it; NaN if its metrics do not say."""
    films: tuple[Path, ...]
    """Of its policy: of the clips of its evaluations the first, the middle and the last, then the
    newest of what else was filmed."""
    troubles: list[str]
    """Seeds that diverged, simulations that broke down or met limits; a line each."""

    @property
    def options(self) -> dict[str, Any]:
        """Full name, such as potential.gamma, -> value."""
        return by_full_name(to_dict(self.manifest.config))


class Found(NamedTuple):
    """Runs, and a line for whatever was left out."""

    runs: list[Run]
    skipped: list[str]


def find(roots: Sequence[str | Path]) -> Found:
    """Reads every run in and below folders.

    A run is a folder with config.json and metrics.csv, or NAME.csv with its config as NAME.json.

    Raises:
      UserError: a folder does not exist, or none holds a run.
    """
    found = Found([], [])
    for root in map(Path, roots):
        if not root.is_dir():
            raise UserError(f"{root}: is no folder; give the folder of a run or one with runs")
        before = len(found.runs) + len(found.skipped)
        for table, config, name in _candidates(root):
            _read_into(found, table, config, name)
        if len(found.runs) + len(found.skipped) == before:
            found.skipped.append(f"{root}: no run in it")
    if not found.runs:
        more = f" and {len(found.skipped) - 3} more" * (len(found.skipped) > 3)
        why = "; ".join(found.skipped[:3]) or "no folder was named"
        raise UserError(
            f"no run with an evaluation found: {why}{more}; a run is a folder with config.json "
            "and metrics.csv, as crsfd_jax.train makes it"
        )
    return found


def _candidates(root: Path) -> Iterator[tuple[Path, Path, str]]:
    """Tables that may be metrics, where their config should be, and what to call the run."""
    for folder in (root, *sorted(path for path in root.rglob("*") if path.is_dir())):
        inner = folder.relative_to(root)
        if any(part in _FOREIGN or part.startswith(".") for part in inner.parts):
            continue
        name = str(inner) if inner.parts else root.resolve().name
        run = run_folder.at(folder)
        if run.config.exists():
            yield run.metrics, run.config, name
        else:
            for table in sorted(folder.glob("*.csv")):
                yield table, table.with_suffix(".json"), str(inner / table.stem)


def _read_into(found: Found, table: Path, config: Path, name: str) -> None:
    try:
        if not _is_metrics(table):
            return
        if not config.exists():
            raise UserError(f"{table}: no {config.name} beside it")
        told = manifest.read(config)
        columns = metrics.read(table)
        if SUCCESS not in columns or not len(columns["env_steps"]):
            raise UserError(f"{table}: holds no evaluation yet")
        found.runs.append(_run(name, table, config, told, columns))
    except UserError as error:
        found.skipped.append(str(error))


def _is_metrics(table: Path) -> bool:
    """False for tables of another kind that lie among metrics."""
    if _is_of_folder(table) or not table.exists():
        return True
    with table.open("rb") as stream:
        return stream.readline().startswith(b"env_steps,seed")


def _is_of_folder(table: Path) -> bool:
    return table == run_folder.at(table.parent).metrics


def _run(
    name: str, table: Path, config: Path, told: Manifest, columns: Mapping[str, np.ndarray]
) -> Run:
    wall = columns.get("time/wall_s", np.array([np.nan]))
    return Run(
        name=name,
        described=config,
        manifest=told,
        curve=curve(columns, SUCCESS),
        exploring=_exploring(columns),
        seeds=np.unique(columns["seed"]),
        wall_s=float(wall.max()),
        films=_films(table.parent) if _is_of_folder(table) else (),
        troubles=[*troubles.diverged(columns), *filter(None, [troubles.words(columns)])],
    )


def _exploring(columns: Mapping[str, np.ndarray]) -> Exploring:
    none = np.zeros(len(columns["env_steps"]))
    rate, episodes = (np.nan_to_num(columns.get(n, none)) for n in (EXPLORING, EPISODES))
    each = {EXPLORING: rate * episodes, EPISODES: episodes}
    found = (curve({**columns, **each}, name) for name in each)
    return Exploring(*(Curve(c.env_steps, np.nancumsum(c.values, axis=0)) for c in found))


def _films(folder: Path) -> tuple[Path, ...]:
    clips = [path for path in run_folder.at(folder).clips.glob("*.gif") if path.stem.isdecimal()]
    clips.sort(key=lambda path: int(path.stem))
    chosen = dict.fromkeys(clips[i] for i in (0, len(clips) // 2, -1)) if clips else {}
    others = [
        path for path in folder.rglob("*") if path.suffix in video.SUFFIXES and path not in clips
    ]
    newest = sorted(others, key=lambda path: path.stat().st_mtime)[-1:]
    return (*chosen, *newest)
