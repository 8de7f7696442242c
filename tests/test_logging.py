"""TensorBoard and Weights & Biases get what metrics.csv says: no more, no less, no other names."""

import json
import math

import pytest

from crsfd_jax.errors import UserError
from crsfd_jax.storage import loggers, metrics

SEEDS = range(3, 5)


def row(seed, env_steps, wall_s=None):
    return {
        "env_steps": env_steps,
        "seed": seed,
        "eval/success_rate": env_steps / 1000 + seed / 100,
        "train/critic_loss": math.nan if env_steps == 300 else -0.125 * seed,
        "time/wall_s": env_steps / 10 if wall_s is None else wall_s,
    }


def evaluate(folder, *env_steps):
    metrics.append(folder / "metrics.csv", [row(s, t) for t in env_steps for s in SEEDS])


@pytest.fixture
def folder(tmp_path):
    told = {"started": "2026-01-02T03:04:05+00:00", "config": {"shape": "2"}}
    told |= {"versions": {"jax": "1.2.3"}, "device": "none"}
    (tmp_path / "config.json").write_text(json.dumps(told))
    return tmp_path


def written(folder):
    """(seed, env_steps, name) -> value, of all rows of metrics.csv."""
    table = metrics.read(folder / "metrics.csv")
    names = [name for name in table if name not in metrics.KEY_COLUMNS]
    return {
        (int(seed), int(step), name): table[name][i]
        for i, (seed, step) in enumerate(zip(table["seed"], table["env_steps"], strict=True))
        for name in names
    }


def agree(found, told):
    """Each value once, and equal in float32."""
    assert sorted(key for key, _ in found) == sorted(told)
    for key, value in found:
        assert value == pytest.approx(told[key], rel=1e-6, nan_ok=True), key


def test_nothing_is_logged_by_default(folder):
    with loggers.opened("none", folder, SEEDS) as log:
        evaluate(folder, 100)
        log()
    assert {path.name for path in folder.iterdir()} == {"config.json", "metrics.csv"}


def test_a_missing_package_is_named_with_its_extra(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"--log tensorboard: .*pip install -e '\.\[tb\]'"):
        loggers.require("tensorboard")
    with pytest.raises(UserError, match=r"--log wandb: .*pip install -e '\.\[wandb\]'"):
        loggers.require("wandb")
    loggers.require("none")


def tensorboard_events(folder):
    """All scalars in the event files, by seed, in the format's own records."""
    from tensorboardX.proto.event_pb2 import Event

    found = []
    for path in sorted((folder / "tensorboard").rglob("events*")):
        content = path.read_bytes()
        while content:
            # A record: length (8 bytes), its checksum (4), the event, its checksum (4).
            length = int.from_bytes(content[:8], "little")
            event = Event.FromString(content[12 : 12 + length])
            content = content[16 + length :]
            seed = int(path.parent.name.removeprefix("seed"))
            found += [((seed, event.step, v.tag), v, event) for v in event.summary.value]
    return found


def test_tensorboard_shows_rows_while_they_appear(folder):
    pytest.importorskip("tensorboardX")
    with loggers.opened("tensorboard", folder, SEEDS) as log:
        for env_steps in (100, 200, 300):
            evaluate(folder, env_steps)
            log()
            found = [(key, value.simple_value) for key, value, _ in tensorboard_events(folder)]
            agree(found, written(folder))


def test_tensorboard_shows_each_row_once_after_a_stop_and_a_resume(folder):
    """The rows of 300 steps were written, but the checkpoint that the run resumes from is older."""
    pytest.importorskip("tensorboardX")
    with loggers.opened("tensorboard", folder, SEEDS) as log:
        evaluate(folder, 100, 200, 300)
        log()
    metrics.truncate(folder / "metrics.csv", 200)
    # The names hold the second of their making, and this test is faster.
    for path in (folder / "tensorboard").rglob("events*"):
        path.rename(path.with_name("events.out.tfevents.1000000000.before"))
    with loggers.opened("tensorboard", folder, SEEDS) as log:
        evaluate(folder, 300, 400)
        log()
    events = tensorboard_events(folder)
    agree([(key, value.simple_value) for key, value, _ in events], written(folder))
    assert {step for (_, step, _), _, _ in events} == {100, 200, 300, 400}


def test_times_of_tensorboard_are_those_of_training(folder):
    """Also for rows that an earlier part of the run wrote: 10 s lie between 100 and 200 steps."""
    pytest.importorskip("tensorboardX")
    evaluate(folder, 100, 200)
    with loggers.opened("tensorboard", folder, SEEDS):
        pass
    at = {step: event.wall_time for (_, step, _), _, event in tensorboard_events(folder)}
    assert at[200] - at[100] == pytest.approx(10, abs=1e-3)


def wandb_records(path):
    """The records of an offline run: a log in blocks of 32 KiB, after 7 bytes that say whose."""
    content, at, record = path.read_bytes(), 7, b""
    while at < len(content):
        left = 32768 - at % 32768
        if left < 7:
            at += left
            continue
        length, kind = int.from_bytes(content[at + 4 : at + 6], "little"), content[at + 6]
        record += content[at + 7 : at + 7 + length]
        at += 7 + length
        is_whole, is_last = kind == 1, kind == 4
        if is_whole or is_last:
            yield record
            record = b""


def wandb_history(folder):
    """All values in the offline runs, in W&B's own records."""
    from wandb.proto.wandb_internal_pb2 import Record

    found, runs = [], {}
    for path in (folder / "wandb").glob("offline-run-*/run-*.wandb"):
        for record in map(Record.FromString, wandb_records(path)):
            if record.HasField("run"):
                runs[path] = record.run
            if record.HasField("history"):
                items = record.history.item
                values = {i.key or "/".join(i.nested_key): json.loads(i.value_json) for i in items}
                found.append((int(runs[path].display_name[-1]), values))
    return found, list(runs.values())


def test_wandb_keeps_each_row_once_in_a_run_for_each_seed(folder, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.delenv("WANDB_MODE", raising=False)
    for env_steps in ((100, 200, 300), (300, 400)):
        with loggers.opened("wandb", folder, SEEDS) as log:
            evaluate(folder, *env_steps)
            log()
        metrics.truncate(folder / "metrics.csv", 200 if 400 not in env_steps else 400)
    history, runs = wandb_history(folder)
    found = [
        ((seed, values["_step"], name), float(value))
        for seed, values in history
        for name, value in values.items()
        if not name.startswith("_")
    ]
    agree(found, written(folder))
    assert {run.run_group for run in runs} == {folder.name}
    assert len({run.run_id for run in runs}) == len(runs) == len(SEEDS)
