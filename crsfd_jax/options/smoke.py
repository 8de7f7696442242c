"""The size of a run that checks in a minute that the whole path works."""

from dataclasses import replace

from crsfd_jax.config import Config, Evaluation


def smoke_sized(config: Config) -> Config:
    """The same run shrunk to a quick check that the whole path works; it learns nothing."""
    return replace(
        config,
        seeds=min(config.seeds, 2),
        steps=min(config.steps, 4096),
        envs=min(config.envs, 16),
        sac=replace(
            config.sac,
            warmup_steps=min(config.sac.warmup_steps, 512),
            updates_per_step=min(config.sac.updates_per_step, 4),
        ),
        potential=replace(config.potential, steps=min(config.potential.steps, 500)),
        evaluation=Evaluation(
            every=min(config.evaluation.every, 2048), episodes=min(config.evaluation.episodes, 10)
        ),
    )
