"""Compiled programs are kept on disk, so that the second run of a kind starts in seconds."""

import os
from pathlib import Path

import jax


def enable() -> None:
    """Uses JAX_COMPILATION_CACHE_DIR, or crsfd_jax under the user's cache folder.

    Also for programs that compile in less than a second: a run has more than a hundred of them.
    """
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if jax.config.jax_compilation_cache_dir is None:
        base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
        jax.config.update("jax_compilation_cache_dir", str(base / "crsfd_jax"))
