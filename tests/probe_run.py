"""Trains on the probe environment: `python probe_run.py FOLDER[,FOLDER] SEEDS [STEPS]`.

Of two runs together, the second one's seeds follow the first one's.
"""

import dataclasses

import probe_env

from crsfd_jax import cli, compile_cache
from crsfd_jax.demos import builtin
from crsfd_jax.training import devices, program, trainer


def run(argv: list[str]) -> int:
    seeds, steps = int(argv[1]), int(argv[2]) if len(argv) > 2 else 1024
    config = dataclasses.replace(probe_env.config(), seeds=seeds, steps=steps)
    configs = [
        dataclasses.replace(config, out=folder, seed=number * seeds)
        for number, folder in enumerate(argv[0].split(","))
    ]
    made = (lambda own: probe_env.make()), probe_env.preparation()
    trainer.build = lambda configs, _: program.assemble(configs, *made)
    compile_cache.enable()
    return trainer.train(configs, builtin.load("builtin"))


if __name__ == "__main__":
    devices.join()
    cli.main(run)
