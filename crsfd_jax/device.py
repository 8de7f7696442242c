"""What a run computes on."""

import os

import jax

from crsfd_jax.config import Config
from crsfd_jax.physics import select


def engine_name(config: Config) -> str:
    """The physics engine that the options stand for here."""
    return select.resolve(config.engine)


def describe(config: Config) -> str:
    """Devices and engine in words."""
    devices = jax.devices()
    kind = devices[0].device_kind
    cores = f", {os.cpu_count()} cores" if jax.default_backend() == "cpu" else ""
    return f"{len(devices)} x {kind}{cores}, engine {engine_name(config)}"
