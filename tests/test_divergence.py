"""Bad numbers: found, kept apart, told, kept for inspection; the other seeds never notice."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import probe_env
import pytest

from crsfd_jax.errors import UserError
from crsfd_jax.interrupt import Interrupt
from crsfd_jax.options.schedule import total_steps
from crsfd_jax.storage import artefacts, checkpoints, metrics, policy, run_folder
from crsfd_jax.training import bookkeeping, divergence, standing, trainer
from crsfd_jax.training.program import assemble
from crsfd_jax.training.standing import Standing

SITES = {
    "actor": lambda states: states.agent.actor,
    "critic": lambda states: states.agent.critic,
    "log_alpha": lambda states: states.agent.log_alpha,
    "optimiser": lambda states: states.agent.optimiser,
    "reward": lambda states: states.replay.storage.reward,
    "priority": lambda states: states.replay.priority,
    "obs": lambda states: states.env.obs,
}
"""Where a number may go bad."""
NOBODY = np.array([], int)


def poisoned(states, site, index):
    """The states with NaN in all numbers of one place of one seed."""
    targets = {id(leaf) for leaf in jax.tree.leaves(SITES[site](states))}

    def poison(leaf):
        hit = id(leaf) in targets and jnp.issubdtype(leaf.dtype, jnp.floating)
        copy = jnp.array(leaf)
        return copy.at[index].set(jnp.nan) if hit else copy

    return jax.tree.map(poison, states)


@pytest.fixture(scope="module", name="config")
def small():
    return probe_env.config()


@pytest.fixture(scope="module")
def program(config):
    return assemble([config], lambda own: probe_env.make(), probe_env.preparation())


@pytest.fixture(scope="module")
def begun(program):
    """States before the first step."""
    return program.start(program.own)


@pytest.fixture
def run(config, program, begun, tmp_path):
    """(index of seeds) -> exit code and folder of a run whose critics start as NaN."""

    def run(index=NOBODY, name="run"):
        def start(own):
            return poisoned(begun, "critic", index)

        with (
            artefacts.open_run(tmp_path / name, config, "probe", []) as folder,
            Interrupt() as interrupt,
        ):
            code = trainer.run([config], program._replace(start=start), [folder], interrupt)
        return code, folder

    return run


def host_leaves(states):
    return [np.asarray(leaf) for leaf in jax.tree.leaves((states.agent, states.replay, states.env))]


@pytest.mark.parametrize("site", SITES)
def test_a_poisoned_seed_leaves_the_others_bit_for_bit_as_they_were(program, begun, site):
    clean, bad = poisoned(begun, site, NOBODY), poisoned(begun, site, 1)
    for step in (0, 16, 32):
        clean, _ = program.advance(clean, program.own, jnp.int32(step))
        bad, _ = program.advance(bad, program.own, jnp.int32(step))
    for a, b in zip(host_leaves(clean), host_leaves(bad), strict=True):
        np.testing.assert_array_equal(a[[0, 2]], b[[0, 2]])
    actors = [states.agent.actor for states in (clean, bad)]
    played = [program.evaluate(actor, program.own, jnp.int32(48)) for actor in actors]
    for a, b in zip(*map(jax.tree.leaves, played), strict=True):
        np.testing.assert_array_equal(np.asarray(a)[[0, 2]], np.asarray(b)[[0, 2]])


def test_a_bad_number_is_found_in_any_parameter_or_loss():
    params = {"kernel": np.zeros((3, 4, 2), np.float32), "count": np.full(3, 2**31 - 1)}
    losses = {"critic_loss": [0.0, 1.0, 2.0]}
    assert divergence.find(params, losses) == {}
    params["kernel"][1, 3, 1] = -np.inf
    losses["critic_loss"][2] = float("nan")
    assert divergence.find(params, losses) == {1: "['kernel']", 2: "critic_loss"}


def test_a_diverged_seed_is_told_kept_and_not_counted(run, capsys, caplog):
    code, folder = run(1)
    assert code == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert "(2 of 3 seeds, seed 1 diverged at 256 steps)" in last.replace("10 of 10 episodes, ", "")
    told = [record.message for record in caplog.records if "diverged" in record.message]
    assert len(told) == 1 and told[0].startswith("seed 1 diverged: .actor['params']")
    table = metrics.read(folder.metrics)
    bad = table["seed"] == 1
    assert (table["train/diverged"] == bad).all()
    assert np.isfinite(np.stack([column[~bad] for column in table.values()])).all()
    assert len(table["seed"]) == 3 * 4


def test_limits_that_the_engine_met_are_in_the_rows_and_said_at_the_end(run, capsys):
    _, folder = run()
    table = metrics.read(folder.metrics)
    counts = [int(table[name].sum()) for name in ("env/contact_limit", "env/solver_limit")]
    # The probe environment says so at the end of each episode.
    assert sum(counts) == table["train/episodes"].sum() and min(counts) > 0
    line = capsys.readouterr().out.splitlines()[-2]
    assert line == (
        f"physics   contacts filled their room in {counts[0]:,}, "
        f"the solver used up its iterations in {counts[1]:,} of 3,072 control steps"
    )


def test_the_state_that_is_kept_is_that_of_the_seed_and_needs_no_pickle(run, program, begun):
    _, folder = run(1)
    (kept,) = folder.path.glob("diverged-*")
    assert kept.name == "diverged-seed1-step256.npz"
    states = poisoned(begun, "critic", 1)
    for step in range(0, 64, 16):
        states, _ = program.advance(states, program.own, jnp.int32(step))
    with np.load(kept, allow_pickle=False) as file:
        np.testing.assert_array_equal(file[".replay.priority"], states.replay.priority[1])
        np.testing.assert_array_equal(file[".key"], jax.random.key_data(states.key[1]))
        assert any(np.isnan(file[name]).any() for name in file.files if "critic" in name)


def test_a_run_whose_seeds_have_all_diverged_ends_with_code_1(run, capsys):
    code, folder = run(np.arange(3))
    assert code == 1
    assert "no seed counts" in capsys.readouterr().out.splitlines()[-1]
    assert metrics.read(folder.metrics)["env_steps"].max() == 256
    assert run(np.arange(3))[0] == 1


def test_a_diverged_seed_stays_so_when_the_run_is_continued(run, config, program, capsys):
    _, folder = run(1)
    restored = checkpoints.restore(folder.checkpoints, jax.eval_shape(program.start, program.own))
    assert restored is not None and restored.step == total_steps(config)
    assert restored.extra["diverged"] == {"1": 256}
    run(1)
    assert "2 of 3 seeds" in capsys.readouterr().out.splitlines()[-1]


def test_a_full_disk_ends_a_run_that_can_be_continued(run, monkeypatch):
    whole = metrics.read(run(name="whole")[1].metrics)

    def full(path, rows):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(UserError) as error:
        patch.setattr(metrics, "append", full)
        run()
    assert error.value.exit_code == 75
    assert "cannot be written: No space left on device; put it right and run" in str(error.value)
    _, folder = run()
    for name, column in metrics.read(folder.metrics).items():
        if name not in metrics.WALL_CLOCK_COLUMNS:
            np.testing.assert_array_equal(column, whole[name])


def test_what_is_evaluated_and_kept_is_the_averaged_actor(run, config, program):
    _, folder = run(name="averaged")
    restored = checkpoints.restore(folder.checkpoints, jax.eval_shape(program.start, program.own))
    assert restored is not None
    agent, steps = restored.state.agent, total_steps(config) * config.envs
    kept = policy.load(folder.policy, jax.eval_shape(lambda: agent.actor))
    jax.tree.map(np.testing.assert_array_equal, kept, agent.average_actor)
    assert not jax.tree.all(jax.tree.map(np.array_equal, kept, agent.actor))
    table = metrics.read(folder.metrics)
    rate = table["eval/success_rate"][table["env_steps"] == steps]
    played = program.evaluate(agent.average_actor, program.own, np.int32(steps))
    np.testing.assert_allclose(rate, np.asarray(played.success).mean(axis=1))


def test_what_there_was_none_of_has_no_average(run, config):
    """The first row of a run whose warm-up lasts beyond its first evaluation."""
    table = metrics.read(run(name="averaged")[1].metrics)
    assert np.isfinite(table["train/q"]).all() and (table["train/alpha"] > 0).all()
    at = Standing(success=[0.0] * 3)
    standing.add_up(at, {"episodes": jnp.array([0, 2, 4]), "successes": jnp.array([0, 1, 1])})
    standing.add_up(at, {"q": jnp.array([0.0, 3, 6]), "learned": jnp.array([0, 0.5, 1])})
    rows = standing.rows(config, at, [1.0] * 3)
    np.testing.assert_allclose([row["train/success_rate"] for row in rows], [np.nan, 0.5, 0.25])
    np.testing.assert_allclose([row["train/q"] for row in rows], [np.nan, 6, 6])


def test_saving_takes_at_most_two_percent_of_the_time_and_begins_at_once():
    for save_s in (0.05, 1.0, 7.0):
        clock = saving = saved_at = last = 0.0
        while clock < 4000:
            clock += 0.2
            if trainer.save_is_due(last, clock - saved_at):
                clock += save_s
                saving += save_s
                saved_at, last = clock, save_s
        spent = saving - save_s
        assert saving > 0 and spent <= 0.02 * clock
        assert spent > 0.015 * clock - save_s


def test_results_of_a_single_evaluation_are_not_started_over_without_checkpoints(run, program):
    _, folder = run()
    kept = metrics.read(folder.metrics)
    last = kept["env_steps"] == kept["env_steps"].max()
    folder.metrics.unlink()
    metrics.append(folder.metrics, [{n: float(c[last][0]) for n, c in kept.items()}])
    before = folder.metrics.read_bytes()
    shutil.rmtree(folder.checkpoints)
    with pytest.raises(UserError, match="holds no checkpoint"):
        bookkeeping.restored([folder], [None], jax.eval_shape(program.start, program.own))
    assert folder.metrics.read_bytes() == before


def test_only_the_first_of_several_processes_draws_curves(config, tmp_path, monkeypatch):
    monkeypatch.setattr(bookkeeping.devices, "is_first", lambda: False)
    at = Standing(step=16, success=[1.0] * config.seeds)
    nothing = run_folder.at(tmp_path)
    assert bookkeeping.conclude(bookkeeping.Run(config, nothing, None, at)) == 0


def test_runs_of_one_program_share_its_time(config, tmp_path, monkeypatch):
    nothing = run_folder.at(tmp_path)
    runs = [bookkeeping.Run(config, nothing, None, Standing(wall_s=wall)) for wall in (1.0, 2.0)]
    monkeypatch.setattr(bookkeeping.time, "monotonic", lambda: 110.0)
    assert bookkeeping.share_time(runs, 100.0) == 110.0
    assert [each.at.wall_s for each in runs] == [6.0, 7.0]
