"""`python -m crsfd_jax.train`: learn an insertion task from demonstrations of another one."""

from crsfd_jax import cli
from crsfd_jax.config import Config, smoke_sized


def run(argv: list[str]) -> int:
    """Trains as the command line says; see --help."""
    config = cli.parse(Config, argv)
    if config.smoke:
        config = smoke_sized(config)
    from crsfd_jax import compile_cache, trainer

    compile_cache.enable()
    return trainer.train(config)


if __name__ == "__main__":
    cli.main(run)
