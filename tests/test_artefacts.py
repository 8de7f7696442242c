"""The run folder: one owner, one set of options, and nobody else's files."""

import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from collections import namedtuple

import pytest

from crsfd_jax.config import Config, Sac
from crsfd_jax.errors import UserError
from crsfd_jax.storage import artefacts, manifest
from crsfd_jax.storage.artefacts import open_run, refuse_full_disk

HOLDER = """
import sys, time
from crsfd_jax.storage.artefacts import open_run
from crsfd_jax.config import Config

with open_run(sys.argv[1], Config(), "cpu", []):
    print("mine", flush=True)
    time.sleep(60)
"""


def enter(path, config=Config(), checkpoint_bytes=1000, device="cpu"):  # noqa: B008
    """Opens a run that leaves something: from then on its options are fixed."""
    with open_run(path, config, device, ["train"]) as run:
        refuse_full_disk(run, checkpoint_bytes)
        run.metrics.touch()
        return run


def refusal(*args, **options) -> str:
    with pytest.raises(UserError) as error:
        enter(*args, **options)
    assert error.value.exit_code == 2
    return str(error.value)


def stop_by(path, error) -> str:
    """The message of an error in the middle of a run, which can go on afterwards."""
    with pytest.raises(UserError) as stop, open_run(path, Config(), "cpu", []):
        raise error
    assert stop.value.exit_code == 75
    return str(stop.value)


def snapshot(folder):
    return {p: p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_new_folder_records_options_versions_device_and_command(tmp_path):
    run = enter(tmp_path / "a" / "b", Config(shift=0.008), device="2 cores")
    manifest = json.loads((run.path / "config.json").read_text())
    assert manifest["config"]["shift"] == 0.008 and manifest["config"]["sac"]["hidden"] == [
        128,
        128,
    ]
    assert {"python", "jax", "mujoco", "mujoco-mjx", "flax", "optax"} <= manifest["versions"].keys()
    assert (manifest["device"], manifest["command"]) == ("2 cores", ["train"])
    assert run.checkpoints.is_dir()


def test_the_same_options_reopen_the_run_and_keep_its_record(tmp_path):
    enter(tmp_path / "run")
    before = json.loads((tmp_path / "run" / "config.json").read_text())
    enter(tmp_path / "run", Config(out="another/way/to/run"))
    after = json.loads((tmp_path / "run" / "config.json").read_text())
    assert after["started"] == before["started"]


def test_more_steps_continue_a_run_and_fewer_do_not(tmp_path):
    enter(tmp_path / "run", Config(steps=10_000))
    enter(tmp_path / "run", Config(steps=20_000))
    assert "steps 20000 -> 10000" in refusal(tmp_path / "run", Config(steps=10_000))


def test_other_options_are_refused_with_old_and_new_values_and_nothing_changes(tmp_path):
    enter(tmp_path / "run")
    before = snapshot(tmp_path)
    changed = Config(steps=40_000, shift=4e-3, envs=32, sac=Sac(gamma=0.9))
    message = refusal(tmp_path / "run", changed)
    assert "shift 0mm -> 4mm, envs 64 -> 32, sac.gamma 0.98 -> 0.9" in message
    lock = tmp_path / "run" / ".lock"
    assert {p: b for p, b in snapshot(tmp_path).items() if p != lock} == {
        p: b for p, b in before.items() if p != lock
    }


def test_a_folder_with_other_content_is_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    assert "thesis.tex" in refusal(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_config_of_another_program_is_left_alone(tmp_path):
    (tmp_path / "config.json").write_text('{"model": "mine"}')
    (tmp_path / ".x.tmp").write_text("mine")
    before = snapshot(tmp_path)
    assert "is not the description of a run" in refusal(tmp_path)
    assert snapshot(tmp_path) == before


def test_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "run").write_text("mine")
    assert "is a file" in refusal(tmp_path / "run")
    assert "cannot be written" in refusal(tmp_path / "run" / "deeper")


FOREIGN = '{"config": {"seeds": 5}, "device": "cpu", "versions": "all of them"}'


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"config": {}}', "\x00", FOREIGN])
def test_a_damaged_record_is_refused_by_name(tmp_path, content):
    enter(tmp_path / "run")
    (tmp_path / "run" / "config.json").write_text(content)
    assert "config.json" in refusal(tmp_path / "run")


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    def denied(descriptor):
        raise PermissionError(13, "Permission denied", str(tmp_path / "run" / "config.json"))

    monkeypatch.setattr(os, "fsync", denied)
    assert "cannot be written: Permission denied" in refusal(tmp_path / "run")


def test_a_folder_whose_parent_cannot_be_made_is_refused():
    assert "/proc/none/run: cannot be written" in refusal("/proc/none/run")


def test_an_error_inside_the_block_is_not_mistaken_for_a_bad_folder(tmp_path):
    with pytest.raises(FileNotFoundError), open_run(tmp_path / "run", Config(), "cpu", []):
        (tmp_path / "elsewhere").read_text()


def test_a_disk_that_fails_in_the_middle_of_a_run_stops_it_until_it_is_put_right(tmp_path):
    for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS):
        message = stop_by(tmp_path / "run", OSError(number, os.strerror(number)))
        assert f"cannot be written: {os.strerror(number)}; put it right" in message
    inside = str(tmp_path / "run" / "metrics.csv")
    assert "Permission denied" in stop_by(
        tmp_path / "run", PermissionError(13, "Permission denied", inside)
    )
    with pytest.raises(OSError, match="Broken"):
        stop_by(tmp_path / "run", BrokenPipeError(errno.EPIPE, "Broken pipe"))


def test_the_lock_of_a_dead_owner_does_not_count_even_if_its_number_lives_on(tmp_path):
    enter(tmp_path / "run")
    (tmp_path / "run" / ".lock").write_text(f"process {os.getpid()} on here since 2026-01-01")
    enter(tmp_path / "run")
    assert (tmp_path / "run" / ".lock").read_text().startswith(f"process {os.getpid()} on ")


def test_what_a_killed_process_left_half_written_is_removed(tmp_path):
    enter(tmp_path / "run")
    (tmp_path / "run" / ".metrics.csv.x7_a.tmp").write_text("half")
    (tmp_path / "run" / "notes.tmp").write_text("mine")
    enter(tmp_path / "run")
    assert not (tmp_path / "run" / ".metrics.csv.x7_a.tmp").exists()
    assert (tmp_path / "run" / "notes.tmp").exists()


def test_the_engine_and_the_target_may_change_when_a_run_goes_on(tmp_path, caplog):
    enter(tmp_path / "run", device="2 cores, engine native")
    changed = Config(engine="mjx", target=0.9, clips=True)
    enter(tmp_path / "run", changed, device="2 cores, engine mjx")
    assert "not bit-equal from here on: 2 cores, engine native, now 2 cores, engine mjx" in (
        caplog.text
    )
    assert artefacts.read_config(tmp_path / "run") == changed


def test_an_option_that_is_younger_than_a_run_is_read_as_what_was_done_then(tmp_path):
    enter(tmp_path / "run")
    file = tmp_path / "run" / "config.json"
    manifest = json.loads(file.read_text())
    del manifest["config"]["sac"]["reward_scale"], manifest["config"]["sac"]["actor_tau"]
    del manifest["config"]["replay"]["draw_demos"]
    file.write_text(json.dumps(manifest))
    before = artefacts.read_config(tmp_path / "run")
    assert (before.sac.reward_scale, before.sac.actor_tau) == (1.0, 1.0)
    assert before.replay.draw_demos == "yes"


def test_an_option_that_the_folder_does_not_know_yet_had_its_default(tmp_path):
    enter(tmp_path / "run")
    file = tmp_path / "run" / "config.json"
    manifest = json.loads(file.read_text())
    del manifest["config"]["target"], manifest["config"]["seeds"]
    file.write_text(json.dumps(manifest))
    assert artefacts.read_config(tmp_path / "run") == Config()
    assert "seeds 5 -> 6" in refusal(tmp_path / "run", Config(seeds=6))
    enter(tmp_path / "run")
    manifest["config"]["colour"] = "red"
    file.write_text(json.dumps(manifest))
    assert "colour are unknown to this version" in refusal(tmp_path / "run")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seeds", "two"),
        ("seeds", 2.5),
        ("smoke", 1),
        ("shift", None),
        ("shift", float("nan")),
        ("shape", 2),
        ("target", [1]),
    ],
)
def test_a_value_of_another_kind_is_refused(tmp_path, name, value):
    file = enter(tmp_path / "run").path / "config.json"
    manifest = json.loads(file.read_text())
    manifest["config"][name] = value
    file.write_text(json.dumps(manifest))
    with pytest.raises(UserError, match=f"{name} is .*, not a value of that option"):
        artefacts.read_config(tmp_path / "run")


def test_a_start_that_was_refused_leaves_the_choice_of_options(tmp_path):
    assert "MB free" in refusal(tmp_path / "run", Config(seeds=10_000), checkpoint_bytes=10**15)
    run = enter(tmp_path / "run", Config(seeds=3))
    assert artefacts.read_config(run.path).seeds == 3
    assert "seeds 3 -> 4" in refusal(tmp_path / "run", Config(seeds=4))


def test_a_disk_without_room_for_the_checkpoints_is_refused(tmp_path, monkeypatch):
    usage = namedtuple("usage", "free")(free=2_500_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    message = refusal(tmp_path / "run", checkpoint_bytes=1_000_000)
    assert "2 MB free, expected 3 MB" in message
    run = enter(tmp_path / "run", checkpoint_bytes=800_000)
    for step in ("10", "20"):
        (run.checkpoints / step).mkdir()
    enter(tmp_path / "run", checkpoint_bytes=2_000_000)


def test_other_versions_are_told_when_a_run_is_continued(tmp_path, monkeypatch, caplog):
    enter(tmp_path / "run")
    monkeypatch.setattr(manifest, "versions", lambda: {"jax": "9.9"})
    enter(tmp_path / "run")
    assert "9.9" in caplog.text and "versions" in caplog.text


def test_a_second_process_is_refused_and_a_killed_one_frees_the_folder(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "mine\n"
        assert f"in use by process {holder.pid} on " in refusal(tmp_path / "run")
        holder.send_signal(signal.SIGKILL)
    enter(tmp_path / "run")


def test_every_option_but_steps_and_out_counts_as_another_run(tmp_path):
    enter(tmp_path / "run")
    for field, value in (("seeds", 6), ("demos", "x.npz"), ("smoke", True), ("shape", "3")):
        changed = dataclasses.replace(Config(), **{field: value})
        message = refusal(tmp_path / "run", changed)
        assert f"{field} " in message
        assert "--steps may grow; --engine, --target, --log, --clips may change" in message
