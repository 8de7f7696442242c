"""New insertion tasks learned from demonstrations of another one (CRSfD) in JAX and MuJoCo."""

import os

# XLA's fusion emitters compile MJX on a CPU into code that is about a hundred times slower. The
# flag is read when jax starts and concerns CPUs only; a value that the user set is left alone.
_SLOW_EMITTERS = "--xla_cpu_use_fusion_emitters"
if _SLOW_EMITTERS not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_SLOW_EMITTERS}=false".strip()
