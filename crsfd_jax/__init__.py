"""New insertion tasks learned from demonstrations of another one (CRSfD) in JAX and MuJoCo."""

import os
import sys
from importlib import metadata

# GPUs and TPUs multiply float32 matrices in fewer bits unless told: too few for tenths of a
# millimetre at the end of an arm. A value that the user set is left alone.
_FULL = "highest"
os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", _FULL)
if (_jax := sys.modules.get("jax")) and _jax.config.jax_default_matmul_precision is None:
    _jax.config.update("jax_default_matmul_precision", _FULL)  # It read the variable before.

# XLA's fusion emitters compile MJX on a CPU into code that is about a hundred times slower. The
# flag is read when jax starts and concerns CPUs only; a value that the user set is left alone.
# From jaxlib 0.11 on there is no such flag, and a process that sets it ends.
_SLOW_EMITTERS = "--xla_cpu_use_fusion_emitters"
_HAS_FLAG = tuple(map(int, metadata.version("jaxlib").split(".")[:2])) < (0, 11)
if _HAS_FLAG and _SLOW_EMITTERS not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_SLOW_EMITTERS}=false".strip()
