"""Compiled programs are kept on disk, so that the second run of a kind starts in seconds."""

import os
from pathlib import Path

import jax


def enable() -> None:
    """Uses JAX_COMPILATION_CACHE_DIR, or crsfd_jax under the user's cache folder."""
    if jax.config.jax_compilation_cache_dir is None:
        base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
        jax.config.update("jax_compilation_cache_dir", str(base / "crsfd_jax"))
