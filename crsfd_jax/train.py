"""`python -m crsfd_jax.train`: learn an insertion task from demonstrations of another one."""

from crsfd_jax import cli, loggers
from crsfd_jax.config import Config, smoke_sized
from crsfd_jax.demos import builtin
from crsfd_jax.report import opengl


def run(argv: list[str]) -> int:
    """Trains as the command line says; see --help."""
    config = cli.parse(Config, argv)
    loggers.require(config.log)
    if config.clips:
        opengl.platform()
    if config.smoke:
        config = smoke_sized(config)
    demos = builtin.load(config.demos, config.demo_episodes)
    # jax takes seconds to import: what is wrong with the input is said before.
    from crsfd_jax import compile_cache, spread, trainer

    compile_cache.enable()
    spread.join()
    return trainer.train(config, demos)


if __name__ == "__main__":
    cli.main(run)
