"""Policies come back as they were saved; any other file can do no more than be refused."""

import io
import os
import zipfile

import jax
import numpy as np
import pytest

from crsfd_jax.errors import UserError
from crsfd_jax.storage import policy

ACTOR = {
    "kernel": np.arange(24, dtype=np.float32).reshape(2, 3, 4),
    "bias": np.ones((2, 4), np.float32),
}


@pytest.fixture
def file(tmp_path):
    policy.save(tmp_path / "policy.npz", ACTOR)
    return tmp_path / "policy.npz"


def rewritten(file, **changes):
    with np.load(file) as archive:
        arrays = dict(archive)
    np.savez(file, **(arrays | {f"['{name}']": value for name, value in changes.items()}))


def refusal(file, like=ACTOR) -> str:
    with pytest.raises(UserError) as error:
        policy.load(file, like)
    assert error.value.exit_code == 2 and str(file) in str(error.value)
    return str(error.value)


def test_what_is_saved_is_loaded_bit_for_bit(file):
    loaded = policy.load(file, jax.eval_shape(lambda: ACTOR))
    jax.tree.map(np.testing.assert_array_equal, loaded, ACTOR)


def test_networks_of_other_sizes_are_refused_with_both(file):
    other = ACTOR | {"bias": np.ones((2, 5), np.float32)}
    assert "['bias'] is (2, 4), expected (2, 5)" in refusal(file, other)
    assert "arrays missing: ['gain'].npy" in refusal(file, ACTOR | {"gain": ACTOR["bias"]})


def test_a_file_cut_short_anywhere_is_refused(file):
    content = file.read_bytes()
    for size in range(0, len(content), 37):
        file.write_bytes(content[:size])
        refusal(file)


def test_python_objects_are_never_made(file):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(file.with_name("sprung")),))

    rewritten(file, bias=np.array([Trap()], object))
    assert "contains Python objects; refused" in refusal(file)
    assert not file.with_name("sprung").exists()


def test_an_archive_that_unpacks_to_too_much_is_refused_before_unpacking(file, monkeypatch):
    monkeypatch.setattr(policy, "_MAX_BYTES", 10_000)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data + bytes(100_000))
    file.write_bytes(stream.getvalue())
    assert file.stat().st_size < 10_000
    assert "allowed: at most 10000" in refusal(file)


def test_a_link_is_not_followed(file):
    file.rename(file.with_name("real.npz"))
    file.symlink_to("real.npz")
    assert "is a link" in refusal(file)
