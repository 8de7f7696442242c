"""The folder of a run that was never trained: its second seed inserts by a policy made by hand."""

import dataclasses
import json
from pathlib import Path

import numpy as np

from crsfd_jax import config
from crsfd_jax.observation import OBS_SIZE
from crsfd_jax.storage import manifest, metrics, policy

WIDTH = 11
OPTIONS = config.Config(
    shape="2", engine="native", seed=3, seeds=2, sac=config.Sac(hidden=(WIDTH, WIDTH))
)


def write(folder: Path, options: config.Config = OPTIONS) -> Path:
    """A run with the seeds 3, a random policy, and 4, the one made by hand."""
    folder.mkdir()
    told = {
        "config": dataclasses.asdict(options),
        "versions": manifest.versions(),
        "device": "none",
        "started": "2026-01-02T03:04:05+00:00",
    }
    (folder / "config.json").write_text(json.dumps(told))
    layers = [np.stack(pair) for pair in zip(random_actor(), expert_actor(), strict=True)]
    policy.save(folder / "policy.npz", as_parameters(layers))
    metrics.append(folder / "metrics.csv", [row(s, t) for t in (1000, 2000) for s in (3, 4)])
    return folder


def row(seed: int, env_steps: int) -> dict[str, float]:
    """What the random policy and the expert would be recorded with."""
    return {
        "env_steps": env_steps,
        "seed": seed,
        "eval/success_rate": float(seed == 4 and env_steps == 2000),
        "eval/episode_length": 20.5,
        "eval/episodes": 50,
        "train/critic_loss": 0.25 * seed,
        "time/wall_s": env_steps / 100,
    }


def as_parameters(arrays: list[np.ndarray]) -> dict:
    """Kernels and biases in turn, as the actor names them."""
    pairs = zip(arrays[::2], arrays[1::2], strict=True)
    dense = {f"Dense_{i}": {"kernel": k, "bias": b} for i, (k, b) in enumerate(pairs)}
    return {"params": dense}


def random_actor() -> list[np.ndarray]:
    """Kernels and biases in turn."""
    random = np.random.default_rng(0)
    sizes = ((OBS_SIZE, WIDTH), (WIDTH,), (WIDTH, WIDTH), (WIDTH,), (WIDTH, 12), (12,))
    return [random.normal(0, 0.3, size).astype(np.float32) for size in sizes]


def expert_actor() -> list[np.ndarray]:
    """Moves above the nominal socket, upright, and goes down the nearer it is; for no shift."""
    first, second, last = (np.zeros_like(k) for k in random_actor()[::2])
    beside, tilted = (14, 15), (17, 18, 19)
    for i, part in enumerate((*beside, *tilted)):
        # Two units hold what is positive and what is negative, so that relu loses nothing.
        first[part, 2 * i], first[part, 2 * i + 1] = 1, -1
        gain, action = (3, part - 14) if part in beside else (2, part - 14)
        last[2 * i, action], last[2 * i + 1, action] = -gain, gain
    second[:10, :10] = np.eye(10)
    near = 10
    second[:4, near], last[near, 2] = -30, -1
    biases = [np.zeros(WIDTH, np.float32), np.zeros(WIDTH, np.float32), np.zeros(12, np.float32)]
    biases[1][near] = 1.5
    kernels = (first, second, last)
    return [array for pair in zip(kernels, biases, strict=True) for array in pair]
