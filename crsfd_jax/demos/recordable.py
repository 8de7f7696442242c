"""Recording in a task: whether a replay can set it up again, and what a file says of it."""

import datetime

from crsfd_jax import config
from crsfd_jax.demos.provenance import Provenance, obs_layout
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.storage import manifest


def refusal(options: config.Config) -> str:
    """Why demonstrations of this task could not be replayed, or "" if they could."""
    if options.scene != config.Scene(clearance=options.scene.clearance):
        return "recording needs the default footprint and friction of the scene"
    if options.mdp.action_scale != config.Mdp().action_scale:
        return "recording needs the default action scales"
    if options.randomisation != Randomisation():
        return "recording needs a run without randomisation"
    return ""


def provenance(
    task: config.Config,
    *,
    expert: str,
    expert_success_rate: float,
    noise: float,
    seed: int,
    command: str,
) -> Provenance:
    """Of a recording that is made today in a task of one shape."""
    return Provenance(
        shape=task.shape,
        clearance_m=task.scene.clearance,
        shift_m=task.shift,
        control_dt_s=CONTROL_DT,
        obs_layout=obs_layout(),
        action_scale=task.mdp.action_scale,
        expert=expert,
        expert_success_rate=expert_success_rate,
        noise=noise,
        seed=seed,
        command=command,
        versions=manifest.versions(),
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
    )
