"""`python -m crsfd_jax.train`: learn an insertion task from demonstrations of another one.

`--and` between two command lines trains both runs side by side in one program.
"""

from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.demos import builtin
from crsfd_jax.drawing import opengl
from crsfd_jax.options import together
from crsfd_jax.storage import loggers


def run(argv: list[str]) -> int:
    """Trains as the command line says; see --help."""
    configs = [_parsed(line) for line in together.command_lines(argv)]
    together.require_alike(configs)
    demos = builtin.load(configs[0].demos, configs[0].demo_episodes)
    # jax takes seconds to import: what is wrong with the input is said before.
    from crsfd_jax import compile_cache
    from crsfd_jax.training import devices, trainer

    compile_cache.enable()
    devices.join()
    return trainer.train(configs, demos)


def _parsed(argv: list[str]) -> Config:
    config = cli.parse(Config, argv)
    loggers.require(config.log)
    if config.clips:
        opengl.platform()
    return config


if __name__ == "__main__":
    cli.main(run)
