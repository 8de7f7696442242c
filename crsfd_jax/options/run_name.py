"""What a run is called: its method, task and seeds, and every option that is not the usual one."""

import hashlib
import re

from crsfd_jax.config import Config, to_dict
from crsfd_jax.options import shapes
from crsfd_jax.options.names import MAY_CHANGE, by_full_name, show
from crsfd_jax.options.randomisation import TRAINING, Randomisation
from crsfd_jax.options.smoke import smoke_sized
from crsfd_jax.options.units import format_length

_ELSEWHERE = ("algorithm", "shape", "shift", "seed", "seeds", "smoke")
"""Options that every name says."""
_NOWHERE = ("steps", "evaluation.every", "evaluation.episodes", *MAY_CHANGE)
"""How far a run goes, how closely it is looked at, and what may change while it goes on."""
_LONGEST = 200
"""Letters; file systems allow 255 bytes."""


def run_name(config: Config) -> str:
    """Name of a run, such as crsfd-shape2-shift8mm-seed0x5-sac.gamma0.96: five seeds from 0."""
    config, usual = (smoke_sized(c) if config.smoke else c for c in (config, Config()))
    task = f"shape{shapes.label(config.shape)}-shift{format_length(config.shift)}"
    if config.randomisation != Randomisation():
        task += "-randomised"
    words = [config.algorithm, task, f"seed{config.seed}x{config.seeds}"]
    if config.smoke:
        words.append("smoke")
    name = re.sub(r"[^\w.+-]+", "_", "-".join([*words, *_unusual(config, usual)]))
    if len(name) > _LONGEST:
        name = f"{name[:_LONGEST]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    return name


def default_folder(config: Config) -> str:
    """Where a run lies: --out, or its name under runs/."""
    return config.out or f"runs/{run_name(config)}"


def _unusual(config: Config, usual: Config) -> list[str]:
    known = by_full_name(to_dict(usual))
    return [
        f"{option}{show(value, 'x')}"
        for option, value in by_full_name(to_dict(config)).items()
        if value != known[option] and option not in (*_ELSEWHERE, *_NOWHERE)
        # These ranges are what "randomised" means unless others are said.
        if not (option.startswith("randomisation.") and config.randomisation == TRAINING)
    ]
