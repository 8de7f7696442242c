"""Trains on the probe environment: `python probe_run.py FOLDER SEEDS [STEPS]`."""

import dataclasses

import probe_env

from crsfd_jax import cli, compile_cache, program, spread, trainer


def run(argv: list[str]) -> int:
    seeds, steps = int(argv[1]), int(argv[2]) if len(argv) > 2 else 1024
    config = dataclasses.replace(probe_env.config(), out=argv[0], seeds=seeds, steps=steps)
    made = probe_env.make(), probe_env.preparation()
    trainer.build = lambda config, _: program.assemble(config, *made)
    compile_cache.enable()
    return trainer.train(config, None)


if __name__ == "__main__":
    spread.join()
    cli.main(run)
