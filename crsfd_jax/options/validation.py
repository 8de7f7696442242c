"""Values of a configuration that must fit each other, besides their own ranges."""

from crsfd_jax.config import Config, Scene
from crsfd_jax.errors import UserError
from crsfd_jax.options import schedule, shapes
from crsfd_jax.options.limits import check_limits
from crsfd_jax.options.units import format_length


def validate(config: Config) -> None:
    """Checks every value against its range, and the values that belong together.

    Raises:
      UserError: the first value that cannot be used, and what to change.
    """
    check_limits(config)
    capacity, envs = config.replay.capacity, config.envs
    if capacity < envs or capacity % envs:
        nearest = max(1, round(capacity / envs)) * envs
        raise UserError(
            f"--replay.capacity: got {capacity}, allowed: multiples of --envs ({envs}); "
            f"use {nearest}"
        )
    if schedule.warmup_steps(config) >= (steps := schedule.total_steps(config)):
        raise UserError(
            f"--sac.warmup-steps: got {config.sac.warmup_steps}, allowed: at most "
            f"{(steps - 1) * envs} of the {steps * envs} that {config.steps} --steps of {envs} "
            "--envs make; lower it or raise --steps"
        )
    has_own = config.algorithm.startswith("crsfd") and config.algorithm != "crsfd_same_gamma"
    if has_own and config.potential.gamma > config.sac.gamma:
        raise UserError(
            f"--potential.gamma: got {config.potential.gamma:g}, allowed: at most --sac.gamma "
            f"({config.sac.gamma:g}); lower it or raise --sac.gamma"
        )
    validate_parts(config.scene, config.shape)


def validate_parts(scene: Scene, shape: str) -> None:
    """Checks that every shape with these sizes leaves a peg wide enough for its contact spheres.

    Raises:
      UserError: the clearance leaves too little of a cell.
    """
    most = max(max(len(g), len(g[0])) for g in map(shapes.grid, shapes.read(shape)))
    cell = scene.footprint / most
    if scene.clearance > cell - shapes.THINNEST + 1e-9:
        raise UserError(
            f"--scene.clearance: got {format_length(scene.clearance)}, allowed: at most a cell of "
            f"the shape ({format_length(cell)}) less {format_length(shapes.THINNEST)}; lower it or "
            "raise --scene.footprint"
        )
