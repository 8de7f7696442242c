"""What a machine offers: versions, devices, drawing, compiled programs kept, engine speed."""

import functools
import os
import re
import time
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import mujoco

from crsfd_jax import compile_cache, config, extras, task
from crsfd_jax.drawing import picture
from crsfd_jax.env import Env, EnvState
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE
from crsfd_jax.physics import select
from crsfd_jax.scene.build import build, model_of
from crsfd_jax.storage import manifest

PACKAGES = ("numpy", "matplotlib", "pillow", "tyro", "rich")
"""Besides those that a run folder lists."""
SEEDS = config.Config.seeds
ENVS = {"native": (config.Config.envs, 4 * config.Config.envs)}
"""Environments of each seed to measure, the default first: learning is tuned for it, so that fewer
are not suggested. Other engines compile for long and are measured once."""
_STEPS = 4
_ENOUGH = 0.9
"""Share of the best speed that a smaller number of environments must reach to be suggested."""
_DISTRIBUTION = "crsfd-jax"


def examine(engines: Iterable[str], seconds: float) -> dict[str, Any]:
    """Everything that the doctor reports, as plain values.

    Args:
      engines: names to measure; none for the one that auto stands for.
      seconds: time for each of them, once compiled.
    """
    compile_cache.enable()
    own = select.resolve("auto")
    rates, problems = _rates(tuple(engines) or (own,), seconds)
    return {
        "versions": manifest.versions() | _versions(PACKAGES),
        "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
        "cores": os.cpu_count(),
        "opengl": _drawing(),
        "compile_cache": _cache(),
        "engine": own,
        "engines": rates,
        "engine_problems": problems,
        "suggested_envs": suggested_envs([rate for rate in rates if rate["engine"] == own]),
        "extras": _extras(metadata.requires(_DISTRIBUTION) or []),
    }


def suggested_envs(rates: list[dict[str, Any]]) -> int:
    """The fewest environments of a seed that nearly reach the best speed measured.

    Fewer environments mean more updates for each step, so more of them must pay.
    """
    best = max((rate["steps_per_s"] for rate in rates), default=0.0)
    enough = [rate["envs"] for rate in rates if rate["steps_per_s"] >= _ENOUGH * best]
    return min(enough, default=config.Config.envs)


def steps_per_second(engine: str, count: int, seconds: float) -> float:
    """Control steps of all environments per second, under random actions, once compiled."""
    env = task.make_env(config.Config(engine=engine))  # pyright: ignore[reportArgumentType]
    key = jax.random.key(0)
    roll = jax.jit(functools.partial(_roll, env))
    state = jax.block_until_ready(roll(env.reset(key, count), key))
    calls, start = 0, time.perf_counter()
    while not calls or time.perf_counter() - start < seconds:
        state = jax.block_until_ready(roll(state, key))
        calls += 1
    return calls * count * _STEPS / (time.perf_counter() - start)


def _roll(env: Env, state: EnvState, key: jax.Array) -> EnvState:
    def step(state, key):
        action = jax.random.uniform(key, (len(state.age), ACTION_SIZE), minval=-1, maxval=1)
        return env.step(state, action, key)[0], None

    return jax.lax.scan(step, state, jax.random.split(key, _STEPS))[0]


def _rates(engines: tuple[str, ...], seconds: float) -> tuple[list[dict[str, Any]], dict[str, str]]:
    rates, problems = [], {}
    for engine in engines:
        sizes = ENVS.get(engine, (config.Config.envs,))
        try:
            select.resolve(engine)
            for envs in sizes:
                speed = round(steps_per_second(engine, SEEDS * envs, seconds / len(sizes)), 1)
                rates.append({"engine": engine, "seeds": SEEDS, "envs": envs, "steps_per_s": speed})
        except UserError as error:
            problems[engine] = str(error)
    return rates, problems


def _drawing() -> dict[str, Any]:
    """Draws one small picture."""
    from crsfd_jax.drawing import opengl

    scene = build(config.Scene())
    model = model_of(scene, 0)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    try:
        pixels = picture.render(model, data, "scene", 32, 32)
    except UserError as error:
        return {"works": False, "problem": str(error)}
    blank = int(pixels.min()) == int(pixels.max())
    if blank:
        return {"works": False, "problem": f"{opengl.platform()} draws blank pictures"}
    return {"works": True, "platform": opengl.platform()}


def _cache() -> dict[str, Any]:
    folder = Path(jax.config.jax_compilation_cache_dir)
    files = [path for path in folder.rglob("*") if path.is_file()] if folder.is_dir() else []
    return {"folder": str(folder), "bytes": sum(path.stat().st_size for path in files)}


def _versions(names: Iterable[str]) -> dict[str, str]:
    return {name: metadata.version(name) for name in names}


def _extras(requirements: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Extra -> the packages of it that are not installed, and the command that brings them."""
    found: dict[str, dict[str, Any]] = {}
    for requirement in requirements:
        extra = _extra_of(requirement)
        if extra:
            command = extras.install_command(extra)
            found.setdefault(extra, {"missing": [], "install": command})["missing"].extend(
                _missing(requirement)
            )
    return found


def _extra_of(requirement: str) -> str:
    match = re.search(r"""extra\s*==\s*['"]([\w-]+)['"]""", requirement)
    return match[1] if match else ""


def _missing(requirement: str) -> list[str]:
    """The package that a requirement names, or those that its own extras name, if not here."""
    match = re.match(r"([\w.-]+)(?:\[([\w,-]+)\])?", requirement)
    name, wanted = (match[1], (match[2] or "").split(",")) if match else ("", [])
    try:
        inner = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return [name]
    return [
        lost for line in inner if _extra_of(line) in filter(None, wanted) for lost in _missing(line)
    ]
