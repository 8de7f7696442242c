"""What a run computes on."""

import os

import jax

from crsfd_jax.config import Config
from crsfd_jax.physics import select


def describe(config: Config) -> str:
    """Devices and engine in words."""
    devices = jax.devices()
    kind = devices[0].device_kind
    cores = f", {os.cpu_count()} cores" if jax.default_backend() == "cpu" else ""
    return f"{len(devices)} x {kind}{cores}, engine {select.resolve(config.engine)}"
