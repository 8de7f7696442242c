"""The readers and the command line under many more random inputs than in every test run."""

import contextlib
import io
import os
import sys
from pathlib import Path

import pytest
import test_cli
import test_dataset
from hypothesis import example, given, settings
from noted_writes import noted

from crsfd_jax import cli, compile_cache, train
from crsfd_jax.storage import artefacts
from crsfd_jax.training import program, trainer

pytestmark = pytest.mark.faults


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@settings(max_examples=700, deadline=None)
@given(test_dataset.BYTES)
def test_700_demonstration_files_with_changed_bytes_load_or_are_refused(folder, changes):
    with noted() as written:
        test_dataset.check_changed_bytes(folder / "demos.npz", changes)
    assert set(written) == {folder / "demos.npz"}


@settings(max_examples=300, deadline=None)
@given(*test_dataset.PATCHES)
def test_300_arrays_with_changed_bytes_load_or_are_refused(folder, name, patch, position):
    with noted() as written:
        test_dataset.check_patched_array(folder / "demos.npz", name, patch, position)
    assert set(written) == {folder / "demos.npz"}


def open_and_close(configs, _) -> int:
    """All that a run does on disk before it computes, if that is where the test may write."""
    (config,) = map(program.fitted, configs)
    ASKED.append(Path(os.path.realpath(config.out)))
    if ASKED[-1].is_relative_to(Path.cwd()):
        with artefacts.open_run(config.out, config, "cpu", []) as run:
            artefacts.refuse_full_disk(run, 1000)
    return 0


ASKED: list[Path] = []
"""The run folder that a command line asks for."""


@pytest.fixture(scope="module")
def opens_only():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer, "train", open_and_close)
        patch.setattr(compile_cache, "enable", lambda: None)
        yield patch


@settings(max_examples=500, deadline=None)
@given(test_cli.ARGUMENTS)
@example([])
@example(["--smoke", "--out", "run"])
@example(["--out", "run/config.json"])
def test_500_argument_lists_end_with_one_line_and_write_in_the_run_folder_only(
    opens_only, folder, argv
):
    opens_only.setattr(sys, "argv", ["train", *argv])
    ASKED.clear()
    error = io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(error),
        pytest.raises(SystemExit) as end,
        noted() as written,
    ):
        cli.main(train.run)
    said = error.getvalue()
    if end.value.code == 2:
        assert said.startswith("error: ") and said.count("\n") == 1 and said.endswith("\n")
    else:
        assert end.value.code in (None, 0) and (ASKED or {"-h", "--help"} & set(argv))
    for path in written:
        assert ASKED and (path.is_relative_to(ASKED[0]) or ASKED[0].is_relative_to(path))
