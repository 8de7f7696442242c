"""Finds the engine that a run asks for."""

import importlib.util

import jax

from crsfd_jax import extras
from crsfd_jax.errors import UserError
from crsfd_jax.physics.interface import Engine
from crsfd_jax.scene.build import Scene


def resolve(name: str) -> str:
    """The engine that a name stands for on this machine.

    Raises:
      UserError: the engine cannot run here.
    """
    if name == "auto":
        return "native" if jax.default_backend() == "cpu" else "mjx"
    if name == "warp" and importlib.util.find_spec("warp") is None:
        raise UserError(
            "--engine: got 'warp', allowed here: auto, native, mjx; "
            f"install the extra with {extras.install_command('warp')} first"
        )
    return name


def make(name: str, scene: Scene) -> Engine:
    """An engine by its resolved name."""
    if name == "native":
        from crsfd_jax.physics import native

        return native.make(scene)
    from crsfd_jax.physics import mjx

    return mjx.make(scene, impl="jax" if name == "mjx" else name)
