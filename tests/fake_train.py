"""Behaves as `python -m crsfd_jax.train` does on disk and to signals, in a second, without jax.

FAKE_FAIL="CELL KIND, CELL KIND" makes it go wrong in those cells: crash (always, after a step),
usage (exit 2), once (killed after its second step, the first time), stop (exit 75 at once),
crowded (exit 75 at once if there are others in its process).
"""

import os
import signal
import time

from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.errors import DONE, STOPPED, UserError
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.options import together
from crsfd_jax.options.smoke import smoke_sized
from crsfd_jax.storage import artefacts, metrics

STEP = 1024


def run(argv: list[str]) -> int:
    lines = together.command_lines(argv)
    configs = [smoke_sized(cli.parse(Config, line)) for line in lines]
    together.require_alike(configs)
    return max(run_one(config, argv) for config in configs)


def run_one(config: Config, argv: list[str]) -> int:
    with artefacts.open_run(config.out, config, "fake", argv) as folder, Interrupt() as interrupt:
        with (folder.path / "starts").open("a") as starts:
            starts.write(f"{os.getpid()}\n")
        done = max((int(p.name) for p in folder.checkpoints.iterdir()), default=0)
        metrics.truncate(folder.metrics, done * config.envs)
        for env_steps in range(done * config.envs + STEP, config.steps + 1, STEP):
            if interrupt.requested:
                return STOPPED
            misbehave(folder.path, env_steps, together.MARK in argv)
            time.sleep(float(os.environ.get("FAKE_STEP_S", "0.02")))
            metrics.append(folder.metrics, rows(config, env_steps))
            (folder.checkpoints / str(env_steps // config.envs)).mkdir()
        (folder.path / "policy.npz").touch()
    return DONE


def rows(config: Config, env_steps: int) -> list[dict[str, float]]:
    row = {"env_steps": env_steps, "eval/success_rate": 0.25, "time/wall_s": env_steps / 100}
    return [row | {"seed": config.seed + i} for i in range(config.seeds)]


def misbehave(folder, env_steps: int, is_crowded: bool) -> None:
    wrong = os.environ.get("FAKE_FAIL", "").split(", ")
    kind = next((word.split()[1] for word in wrong if word.startswith(f"{folder.name} ")), "")
    if kind == "usage":
        raise UserError("--this: cannot be used")
    if kind == "stop":
        raise UserError("the disk is full", STOPPED)
    if kind == "crowded" and is_crowded:
        raise UserError("out of memory", STOPPED)
    if kind == "crash" and env_steps > STEP:
        raise RuntimeError("something broke")
    first = len((folder / "starts").read_text().split()) == 1
    if kind == "once" and first and env_steps > 2 * STEP:
        os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    cli.main(run)
