"""What the demonstration commands do."""

import dataclasses

import jax

from crsfd_jax import algorithms, task
from crsfd_jax.config import Config
from crsfd_jax.demos import builtin, dataset, exchange, record, recordable, replay, rollout
from crsfd_jax.demos.options import FromRun, Record
from crsfd_jax.errors import DONE, MISSED, UserError
from crsfd_jax.options import shapes, validation
from crsfd_jax.storage import files, trained

_TRIALS = 200


def record_file(options: Record, command: str) -> int:
    """Trains the expert, records it and writes the file; 1 if it learned too little."""
    config = record.training_options(options)
    _validate(config)
    if reason := recordable.refusal(config):
        raise UserError(f"{options.out}: {reason}; leave those options out")
    files.reserve(options.out)

    reached = []

    def report(env_steps: int, success: float) -> None:
        reached.append(success)
        print(f"expert: {env_steps:7d} steps, success {success:.2f}", flush=True)

    print(f"training the expert of shape {shapes.label(options.shape)}", flush=True)
    expert = record.train_expert(options, report)
    _write(options, options.seed, config, expert, command)
    if reached[-1] < options.enough:
        print(f"the expert came to {reached[-1]:.2f} only, below --enough {options.enough:g}")
        return MISSED
    return DONE


def record_run(options: FromRun, command: str) -> int:
    """Records a policy of a run and writes the file."""
    source = trained.load(options.run)
    config = dataclasses.replace(
        source.config,
        shape=source.config.shape if options.shape is None else options.shape,
        shift=source.config.shift if options.shift is None else options.shift,
        engine="auto",
    )
    _validate(config)
    if reason := recordable.refusal(config):
        raise UserError(f"{options.run}: {reason}; choose another run")
    if options.noise and not algorithms.load(config.algorithm).interacts:
        raise UserError(
            f"--noise: got {options.noise:g}, allowed with a policy of {config.algorithm}, which "
            "learns no spread: 0"
        )
    chosen = trained.choose(options.run, source.config, options.seed)
    files.reserve(options.out)
    learned = f"{config.algorithm} on shape {shapes.label(source.config.shape)}"
    described = f"{learned}, seed {chosen.seed}, {chosen.env_steps} environment steps"
    expert = rollout.Expert(source.nets, trained.actor(source, chosen), described)
    _write(options, chosen.seed, config, expert, command)
    return DONE


def show(name: str) -> int:
    """Prints what a file holds."""
    print(dataset.describe(builtin.load(name)))
    return 0


def import_demos(source: str, out: str) -> int:
    """Writes a demonstration file from another format."""
    print(dataset.describe(exchange.import_file(source, out)))
    print(f"written to {out}; python -m crsfd_jax.demos check {out} replays it")
    return 0


def export_demos(name: str, form: str, out: str) -> int:
    """Writes another format from a demonstration file."""
    print(f"written to {exchange.export_file(name, form, out)}")
    return 0


def check(name: str) -> int:
    """Replays a file; 1 if an episode that the file calls successful does not insert."""
    played = replay.replay(builtin.load(name))
    total, lost = len(played.success), int((played.recorded_success & ~played.success).sum())
    print(f"recorded  {played.recorded_success.sum()} of {total} episodes successful")
    print(f"replayed  {played.success.sum()} of {total} episodes successful")
    print(f"largest distance of recorded and replayed tip {played.deviation.max() * 1e3:.3f} mm")
    if lost:
        print(f"{lost} episodes that the file calls successful do not insert here")
    return 1 if lost else 0


def _validate(config: Config) -> None:
    """Raises UserError for a task that cannot be, or that is of several shapes."""
    validation.validate(config)
    if len(shapes.read(config.shape)) > 1:
        raise UserError(
            f"--shape: got {config.shape!r}, allowed: one shape; choose one to demonstrate"
        )


def _write(
    options: Record | FromRun, seed: int, config: Config, expert: rollout.Expert, command: str
) -> None:
    env = task.make_env(config)
    trial_key, key = jax.random.split(jax.random.key(seed + 1))
    trials = rollout.play(env, expert, options.noise, trial_key, _TRIALS)
    source = recordable.provenance(
        config,
        expert=expert.described,
        expert_success_rate=rollout.success_rate(trials),
        noise=options.noise,
        seed=seed,
        command=command,
    )
    episodes = rollout.play(env, expert, options.noise, key, options.episodes)
    demos = rollout.demonstrations(episodes, source)
    dataset.save(options.out, demos)
    print(dataset.describe(demos))
    print(f"written to {options.out}")
