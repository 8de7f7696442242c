"""The host's side of a run: compile, advance, evaluate, record, save, stop, resume."""

import dataclasses
import shlex
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import artefacts, checkpoints, device, metrics, policy
from crsfd_jax.config import Config
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.leaves import stored_bytes
from crsfd_jax.program import (
    CHUNK_STEPS,
    Program,
    build,
    evaluation_period,
    fitted,
    total_steps,
)
from crsfd_jax.progress import progress
from crsfd_jax.report import curves
from crsfd_jax.report.intervals import wilson_interval
from crsfd_jax.train_step import TrainState

STOPPED = 75
"""Exit code of a run that was stopped and can be continued."""
_SAVE_SHARE = 0.02
"""Largest share of the wall time that saving may take."""


@dataclasses.dataclass
class Progress:
    """Where a run stands, besides its states; everything in it is saved with them."""

    step: int = 0
    """Vector steps made."""
    wall_s: float = 0.0
    """Time spent in all sessions of the run."""
    sums: dict[str, list[float]] = dataclasses.field(default_factory=dict)
    """Training metrics added up since the last evaluation, a number for each seed."""
    chunks: int = 0
    """Chunks in `sums`."""
    success: list[float] = dataclasses.field(default_factory=list)
    """Newest success rate of each seed."""


def train(config: Config, demos: Demonstrations) -> int:
    """Runs or continues a run to its end, or until a signal stops it; returns the exit code.

    Raises:
      UserError: the run cannot start: run folder or engine.
    """
    config = fitted(config)
    words = device.describe(config)
    with (
        artefacts.open_run(config.out, config, words, sys.argv) as folder,
        Interrupt() as interrupt,
    ):
        program = build(config, demos)
        size = stored_bytes(jax.eval_shape(program.start))
        artefacts.refuse_full_disk(folder, size)
        _say(f"device    {words}")
        _say(f"task      shape {config.shape}, shift {config.shift * 1e3:g} mm, {config.algorithm}")
        _say(f"buffer    {config.replay.capacity} transitions a seed, {size / 1e6:.0f} MB in all")
        _say(f"folder    {folder.path}")
        return _run(config, program, folder, interrupt)


def _run(
    config: Config, program: Program, folder: artefacts.RunFolder, interrupt: Interrupt
) -> int:
    states, at = _start_or_resume(config, program, folder)
    if at.step < total_steps(config):
        program = _compiled(program, states)
    total, period = total_steps(config), evaluation_period(config)
    began, saved_at, save_s = time.monotonic() - at.wall_s, time.monotonic(), 0.0
    with progress(config.steps, at.step * config.envs) as show:
        while at.step < total and not interrupt.requested:
            states, values = program.advance(states, jnp.int32(at.step))
            at.step += CHUNK_STEPS
            _add_up(at, values)
            at.wall_s = time.monotonic() - began
            if at.step % period == 0 or at.step == total:
                _evaluate(config, program, states, at, folder)
            show(at.step * config.envs, at.success)
            if save_s < _SAVE_SHARE * (time.monotonic() - saved_at) and at.step < total:
                save_s = _save(folder, states, at)
                saved_at = time.monotonic()
        at.wall_s = time.monotonic() - began
        _save(folder, states, at)
        policy.save(folder.path, states.agent.actor)
    if at.step < total:
        _say(f"stopped at {at.step * config.envs} steps, saved; go on with the same command:")
        _say(f"  {_command()}")
        return STOPPED
    _summarise(config, folder, at)
    return 0


def _start_or_resume(config, program, folder) -> tuple[TrainState, Progress]:
    found = checkpoints.restore(folder.checkpoints, jax.eval_shape(program.start))
    if found is not None:
        at = Progress(**found.extra)
        metrics.truncate(folder.metrics, at.step * config.envs)
        _say(f"resumed at {at.step * config.envs} of {config.steps} steps")
        return found.state, at
    metrics.truncate(folder.metrics, 0)
    began = time.monotonic()
    states = jax.block_until_ready(program.start())
    took = time.monotonic() - began
    _say(f"prepared  {config.algorithm} for {config.seeds} seeds in {took:.1f} s")
    return states, Progress()


def _compiled(program: Program, states: TrainState) -> Program:
    _say("compiling one chunk of training steps and the evaluation ...")
    began = time.monotonic()
    advance = program.advance.lower(states, jnp.int32(0)).compile()
    evaluate = program.evaluate.lower(states.agent.actor, jnp.int32(0)).compile()
    _say(f"compiled  in {time.monotonic() - began:.1f} s")
    return program._replace(advance=advance, evaluate=evaluate)


def _add_up(at: Progress, values: dict[str, jax.Array]) -> None:
    for name, value in values.items():
        old = at.sums.get(name, [0.0] * len(value))
        at.sums[name] = [a + float(b) for a, b in zip(old, np.asarray(value), strict=True)]
    at.chunks += 1


def _evaluate(config, program, states, at: Progress, folder) -> None:
    """Plays fresh episodes and writes a row for each seed."""
    env_steps = at.step * config.envs
    played = program.evaluate(states.agent.actor, jnp.int32(env_steps))
    success, length = np.asarray(played.success), np.asarray(played.length)
    at.success = [float(rate) for rate in success.mean(axis=1)]
    rows = []
    for i in range(config.seeds):
        sums = {name: values[i] for name, values in at.sums.items()}
        episodes, successes = sums.pop("episodes", 0.0), sums.pop("successes", 0.0)
        nonfinite = sums.pop("nonfinite", 0.0)
        rows.append(
            {
                "env_steps": env_steps,
                "seed": config.seed + i,
                "eval/success_rate": at.success[i],
                "eval/episode_length": float(length[i].mean()),
                "eval/episodes": config.evaluation.episodes,
                "train/success_rate": successes / max(episodes, 1.0),
                "train/episodes": episodes,
                "env/nonfinite": nonfinite,
                **{f"train/{name}": value / at.chunks for name, value in sums.items()},
                "time/wall_s": at.wall_s,
                "time/env_steps_per_second": env_steps * config.seeds / max(at.wall_s, 1e-9),
            }
        )
    metrics.append(folder.metrics, rows)
    at.sums, at.chunks = {}, 0


def _save(folder, states: TrainState, at: Progress) -> float:
    began = time.monotonic()
    checkpoints.save(folder.checkpoints, at.step, states, dataclasses.asdict(at))
    return time.monotonic() - began


def _summarise(config, folder, at: Progress) -> None:
    curves.plot({config.algorithm: folder.metrics}, folder.curves)
    trials = config.evaluation.episodes * config.seeds
    successes = round(sum(at.success) * config.evaluation.episodes)
    low, high = wilson_interval(successes, trials)
    _say(f"curves    {folder.curves}")
    _say(
        f"final success {successes / trials:.3f}, 95 % interval {low:.3f} to {high:.3f} "
        f"({successes} of {trials} episodes, {config.seeds} seeds), {at.wall_s:.0f} s"
    )


def _command() -> str:
    module = getattr(sys.modules["__main__"], "__spec__", None)
    program = ["python", "-m", module.name] if module else ["python", sys.argv[0]]
    return shlex.join([*program, *sys.argv[1:]])


def _say(line: str) -> None:
    print(line, flush=True)
