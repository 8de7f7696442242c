"""A run in vector steps, one of every environment: how many, and how often it is looked at."""

from crsfd_jax.config import Config

CHUNK_STEPS = 16
"""Vector steps compiled as one program call; a signal is answered after at most one call."""


def total_steps(config: Config) -> int:
    """Vector steps of a run: as many whole chunks as reach its environment steps."""
    return -(-config.steps // (config.envs * CHUNK_STEPS)) * CHUNK_STEPS


def total_env_steps(config: Config) -> int:
    """Environment steps that each seed makes in them."""
    return total_steps(config) * config.envs


def warmup_steps(config: Config) -> int:
    """Vector steps before the first gradient update."""
    return -(-config.sac.warmup_steps // config.envs)


def evaluation_period(config: Config) -> int:
    """Vector steps between two evaluations: the nearest number of whole chunks."""
    return max(1, round(config.evaluation.every / (config.envs * CHUNK_STEPS))) * CHUNK_STEPS
