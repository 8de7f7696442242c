"""Clips of a run: films of its policy as it is, apart from what is learned."""

import os
import signal
import time

import fault_runs
import finished_run
import numpy as np
import pytest
from PIL import Image
from test_view import needs_opengl

from crsfd_jax import config, train
from crsfd_jax.drawing import opengl
from crsfd_jax.errors import UserError
from crsfd_jax.training import clips
from crsfd_jax.viewer import film

OPTIONS = config.Config(
    clips=True, seeds=2, engine="native", sac=config.Sac(hidden=(finished_run.WIDTH,) * 2)
)
EXPERT, RANDOM = finished_run.expert_actor(), finished_run.random_actor()


def actors(first, second):
    """Parameters of two seeds."""
    return finished_run.as_parameters([np.stack(pair) for pair in zip(first, second, strict=True)])


def pictures(path):
    """uint8 [frames, H, W, 3]."""
    with Image.open(path) as gif:
        frames = []
        for i in range(gif.n_frames):
            gif.seek(i)
            frames.append(np.asarray(gif.convert("RGB")))
        return np.stack(frames)


@needs_opengl
def test_a_clip_is_a_small_film_of_the_first_seed_with_the_same_starts_each_time(tmp_path):
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips" / ".64.gif.killed.tmp").write_bytes(b"GIF89a")
    record = clips.recorder(OPTIONS, tmp_path / "clips")
    record(actors(EXPERT, RANDOM), 64)
    record(actors(RANDOM, EXPERT), 128)
    files = sorted((tmp_path / "clips").iterdir())
    assert [path.name for path in files] == ["128.gif", "64.gif"]
    assert max(path.stat().st_size for path in files) < 400_000
    random, expert = map(pictures, files)
    assert len(expert) < len(random) == clips.EPISODES * OPTIONS.mdp.horizon
    assert expert.shape[1:] == random.shape[1:] == (180, 240, 3)
    apart = [np.abs(a.astype(int) - b).mean() for a, b in zip(expert, random, strict=False)]
    assert 3 * apart[0] < max(apart), apart


def test_without_the_option_nothing_is_written(tmp_path):
    clips.recorder(config.Config(), tmp_path)({}, 64)
    assert not list(tmp_path.iterdir())


def test_a_renderer_that_fails_is_told_once_and_stops_nothing(tmp_path, monkeypatch, capsys):
    tried = []

    def fail(*_):
        tried.append(1)
        raise RuntimeError("the driver is gone")

    monkeypatch.setattr(film, "record", fail)
    record = clips.recorder(OPTIONS, tmp_path / "clips")
    for env_steps in (64, 128):
        record(actors(EXPERT, RANDOM), env_steps)
    assert len(tried) == 1 and not list(tmp_path.glob("clips/*.gif"))
    assert capsys.readouterr().out == (
        "clips     none from here on: RuntimeError: the driver is gone\n"
    )


def test_a_machine_without_opengl_is_refused_before_anything_begins(tmp_path, monkeypatch):
    monkeypatch.setattr(opengl, "_PLATFORMS", ("absent",))
    opengl.platform.cache_clear()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="OpenGL: got none that works") as caught:
        train.run(["--clips"])
    assert caught.value.exit_code == 2 and not list(tmp_path.iterdir())
    opengl.platform.cache_clear()


@needs_opengl
@pytest.mark.faults
def test_a_run_killed_in_a_clip_goes_on_to_the_end_of_one_without_clips(whole, tmp_path):
    folder = tmp_path / "run"
    process = fault_runs.start(folder, "--clips")
    # The folder appears when the first clip begins, which takes a second or more.
    while not (folder / "clips").exists():
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert not list(folder.glob("clips/*.gif"))
    code, out = fault_runs.run(folder, "--clips")
    assert code == 0, out
    fault_runs.assert_same(folder, whole)
    assert sorted(path.name for path in folder.glob("clips/*")) == ["2048.gif", "4096.gif"]
