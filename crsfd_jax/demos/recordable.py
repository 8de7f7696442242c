"""Which tasks demonstrations can be recorded in: those that a replay can set up again."""

from crsfd_jax import config
from crsfd_jax.randomisation import Randomisation


def refusal(options: config.Config) -> str:
    """Why demonstrations of this task could not be replayed, or "" if they could."""
    if options.scene != config.Scene(clearance=options.scene.clearance):
        return "recording needs the default footprint and friction of the scene"
    if options.mdp.action_scale != config.Mdp().action_scale:
        return "recording needs the default action scales"
    if options.randomisation != Randomisation():
        return "recording needs a run without randomisation"
    return ""
