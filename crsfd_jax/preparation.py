"""What a run gives its method to learn from before the first step."""

from crsfd_jax import free_space, task
from crsfd_jax.algorithms.method import Preparation
from crsfd_jax.config import Config
from crsfd_jax.demos.dataset import Demonstrations


def make(config: Config, demos: Demonstrations) -> Preparation:
    """Demonstrations, and the free space around the sockets of a run's scene."""
    sampler = free_space.make(task.scene_of(config), config.potential.free_space_extent)
    return Preparation.of(demos, sampler)
