"""Demonstration files: what is written is read back, everything else is refused by name."""

import dataclasses
import io
import json
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crsfd_jax.demos import dataset
from crsfd_jax.demos.dataset import Demonstrations
from crsfd_jax.demos.provenance import Provenance
from crsfd_jax.errors import UserError

OBS, ACTION = 4, 3
LENGTHS = (3, 2)


def make_demos() -> Demonstrations:
    """Two episodes of 3 and 2 steps: the first succeeds, the second times out."""
    rng = np.random.default_rng(0)
    steps, episodes = sum(LENGTHS), len(LENGTHS)
    return Demonstrations(
        obs=rng.normal(size=(steps, OBS)).astype(np.float32),
        action=rng.uniform(-1, 1, (steps, ACTION)).astype(np.float32),
        reward=np.array([0, 0, 1, 0, 0], np.float32),
        next_obs=rng.normal(size=(steps, OBS)).astype(np.float32),
        terminated=np.array([0, 0, 1, 0, 0], bool),
        truncated=np.array([0, 0, 0, 0, 1], bool),
        episode_length=np.array(LENGTHS, np.int32),
        start_qpos=rng.normal(size=(episodes, 7)).astype(np.float32),
        socket_offset=np.zeros((episodes, 2), np.float32),
        provenance=Provenance(
            shape="0",
            clearance_m=1e-3,
            shift_m=0.0,
            control_dt_s=0.1,
            obs_layout=[["x", "m"], ["y", "m"], ["z", "m"], ["yaw", "rad"]],
            action_scale=[0.01, 0.01, 0.05],
            expert="scripted",
            expert_success_rate=0.5,
            noise=1.0,
            seed=3,
            command="python -m crsfd_jax.demos record",
            versions={"jax": "0.10.2"},
            date="2026-11-22",
        ),
    )


@pytest.fixture
def path(tmp_path):
    return tmp_path / "demos.npz"


def write_raw(path, changes=(), drop=()):
    """Writes a file past all checks, with some arrays replaced or left out."""
    dataset.save(path, make_demos())
    with np.load(path) as archive:
        arrays = dict(archive) | dict(changes)
    np.savez(path, **{name: array for name, array in arrays.items() if name not in drop})


def refusal(path, obs_dim=OBS, action_dim=ACTION) -> str:
    with pytest.raises(UserError) as error:
        dataset.load(path, obs_dim, action_dim)
    assert str(path) in str(error.value) and error.value.exit_code == 2
    return str(error.value)


def test_what_is_saved_is_loaded_bit_for_bit(path):
    demos = make_demos()
    dataset.save(path, demos)
    loaded = dataset.load(path, OBS, ACTION)
    assert loaded.provenance == demos.provenance
    for field in dataclasses.fields(Demonstrations):
        if field.name != "provenance":
            before, after = getattr(demos, field.name), getattr(loaded, field.name)
            assert before.dtype == after.dtype
            np.testing.assert_array_equal(before, after)


def test_the_same_demonstrations_make_the_same_file(tmp_path):
    for name in ("a.npz", "b.npz"):
        dataset.save(tmp_path / name, make_demos())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_failed_save_leaves_the_old_file_and_nothing_else(path, monkeypatch):
    dataset.save(path, make_demos())
    before = path.read_bytes()

    def full_disk(stream, **_):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(UserError, match="No space left"):
        dataset.save(path, make_demos())
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_demonstrations_that_break_the_schema_are_not_written(path):
    broken = dataclasses.replace(make_demos(), action=np.full((5, ACTION), 2, np.float32))
    with pytest.raises(UserError, match="action"):
        dataset.save(path, broken)
    assert not path.exists()


def changed(name, index, value):
    array = getattr(make_demos(), name).copy()
    array[index] = value
    return {name: array}


FLOAT = np.float32
BAD_ARRAYS = {
    "nan": (changed("obs", (2, 1), np.nan), "1 non-finite values, first at obs[2, 1]"),
    "inf": (changed("start_qpos", (1, slice(0, 2)), np.inf), "2 non-finite values, first at st"),
    "loud action": (changed("action", (4, 0), 1.5), "action outside [-1, 1], first 1.5 at act"),
    "dense reward": (changed("reward", 1, 0.5), "reward is 0.5 at step 1, expected 1 where"),
    "success without its reward": (changed("reward", 2, 0), "reward is 0 at step 2"),
    "negative reward": (changed("reward", 1, -1), "reward outside [0, 1], first -1 at reward[1]"),
    "millimetres": (
        changed("socket_offset", (0, 1), 4),
        "socket_offset outside [-0.1, 0.1], first",
    ),
    "degrees": (
        changed("start_qpos", (1, 2), -45),
        "start_qpos outside [-6.28319, 6.28319], first",
    ),
    "unscaled": (changed("next_obs", (3, 0), 40), "next_obs outside [-10, 10], first 40 at next_o"),
    "double": ({"obs": np.zeros((5, OBS))}, "obs is float64, expected float32"),
    "big endian": ({"obs": np.zeros((5, OBS), ">f4")}, "obs is >f4, expected float32"),
    "float flag": ({"terminated": np.zeros(5, FLOAT)}, "terminated is float32, expected bool"),
    "objects": ({"obs": np.array([{}], object)}, "obs contains Python objects; refused"),
    "fewer actions": (
        {"action": np.zeros((4, ACTION), FLOAT)},
        "action has shape (4, 3), expected (5",
    ),
    "column vector": (
        {"reward": np.zeros((5, 1), FLOAT)},
        "reward has shape (5, 1), expected (5,)",
    ),
    "scalar obs": ({"obs": np.zeros((), FLOAT)}, "obs has shape ()"),
    "nothing": ({"obs": np.zeros((0, OBS), FLOAT)}, "obs has shape (0, 4)"),
    "six joints": (
        {"start_qpos": np.zeros((2, 6), FLOAT)},
        "start_qpos has shape (2, 6), expected (2, 7",
    ),
    "short sum": ({"episode_length": np.array([3, 1], np.int32)}, "episode_length adds up to 4"),
    "overflow": ({"episode_length": np.array([2**31 - 1] * 2, np.int32)}, "adds up to 4294967294"),
    "negative length": ({"episode_length": np.array([6, -1], np.int32)}, "shortest of -1"),
    "moved end": ({"episode_length": np.array([2, 3], np.int32)}, "wrong at step 1"),
    "ends early": (changed("terminated", 0, True), "terminated or truncated is wrong at step 0"),
    "never ends": (changed("truncated", 4, False), "terminated or truncated is wrong at step 4"),
    "no success": (
        changed("terminated", 2, False) | changed("truncated", 2, True),
        "no successful episode among 2",
    ),
    "far socket": (
        {"socket_offset": np.full((2, 2), 1e-3, FLOAT)},
        "socket_offset is up to 0.001 m, expected at most half of provenance.shift_m (0 m)",
    ),
    "extra": ({"bonus": np.zeros(3)}, "unknown or twice: bonus.npy"),
    "not json": ({"provenance": np.array("{")}, "provenance is not JSON"),
    "two texts": ({"provenance": np.array(["{}", "{}"])}, "provenance is not JSON"),
    "number": ({"provenance": np.array("3")}, "provenance is a JSON int, expected an object"),
    "bytes": ({"provenance": np.array(b"{}")}, "provenance is |S2, expected <U"),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_a_wrong_array_is_refused_by_name(path, case):
    changes, answer = BAD_ARRAYS[case]
    write_raw(path, changes)
    assert answer in refusal(path)


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Demonstrations)])
def test_a_missing_array_is_refused_by_name(path, name):
    write_raw(path, drop=[name])
    assert f"arrays missing: {name}.npy" in refusal(path)


BAD_PROVENANCE = {
    "schema": (2, "schema is 2, this program reads 1"),
    "seed": ("3", "provenance.seed is '3'"),
    "noise": (float("inf"), "provenance.noise is 'inf'"),
    "obs_layout": ([["x", "m"]], "provenance.obs_layout has 1 entries, expected 4"),
    "action_scale": ([1, 2, "3"], "provenance.action_scale"),
    "expert": (None, "provenance.expert"),
    "shift_m": (8.0, "provenance.shift_m is 8, expected 0 to 0.02; check its unit"),
    "versions": ({"jax": 1}, "provenance.versions"),
    "extra": (1, "unknown ['extra']"),
}


@pytest.mark.parametrize("name", BAD_PROVENANCE)
def test_wrong_provenance_is_refused_by_name(path, name):
    value, answer = BAD_PROVENANCE[name]
    values = dataclasses.asdict(make_demos().provenance) | {name: value}
    write_raw(path, {"provenance": np.array(json.dumps(values))})
    assert answer in refusal(path)


def test_a_file_of_another_task_is_refused_with_both_sizes(path):
    dataset.save(path, make_demos())
    assert "obs has shape (5, 4), expected (5, 9)" in refusal(path, obs_dim=9)
    assert "action has shape (5, 3), expected (5, 6)" in refusal(path, action_dim=6)


def test_what_is_no_npz_file_is_refused(path, tmp_path):
    assert "No such file" in refusal(path)
    assert "Is a directory" in refusal(tmp_path)
    for content in (b"", b"PK\x03\x04", b"hello", pickle.dumps([1])):
        path.write_bytes(content)
        assert "not a readable .npz file" in refusal(path)
    np.save(tmp_path / "one.npy", np.zeros(3))
    assert "not a readable .npz file" in refusal(tmp_path / "one.npy")


def test_links_pipes_and_devices_are_refused_and_never_read(path, tmp_path):
    dataset.save(path, make_demos())
    (tmp_path / "link.npz").symlink_to(path)
    assert f"is a link; give the file itself, {path}" in refusal(tmp_path / "link.npz")
    (tmp_path / "loop.npz").symlink_to(tmp_path / "loop.npz")
    assert "is a link" in refusal(tmp_path / "loop.npz")
    os.mkfifo(tmp_path / "pipe.npz")
    assert "a device or a pipe" in refusal(tmp_path / "pipe.npz")
    assert "a device or a pipe" in refusal(Path("/dev/zero"))


def test_a_file_cut_short_anywhere_is_refused(path):
    dataset.save(path, make_demos())
    content = path.read_bytes()
    for size in range(0, len(content), 97):
        path.write_bytes(content[:size])
        refusal(path)


def test_a_pickle_in_the_archive_is_never_run(path, tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    write_raw(path, {"obs": np.array([Trap()], object)})
    assert "Python objects" in refusal(path)
    assert not (tmp_path / "sprung").exists()


def replace_member(path, name, content):
    with zipfile.ZipFile(path) as archive:
        members = {m: archive.read(m) for m in archive.namelist()} | {name: content}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, data in members.items():
            archive.writestr(member, data)


def test_a_header_that_declares_more_than_there_is_allocates_nothing(path):
    dataset.save(path, make_demos())
    header = io.BytesIO()
    shape = (10**11, OBS)
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f4", "fortran_order": False, "shape": shape}
    )
    replace_member(path, "obs.npy", header.getvalue() + bytes(80))
    assert f"obs declares shape {shape}, but holds 80 bytes" in refusal(path)


@pytest.mark.parametrize(
    "header", ["(", "    1\n  2\n", "{'descr': [", "{}", "(" * 5000, "\0", "1" * 9000]
)
def test_a_header_that_cannot_be_parsed_is_refused(path, header):
    dataset.save(path, make_demos())
    size = len(header).to_bytes(2, "little")
    replace_member(path, "obs.npy", b"\x93NUMPY\x01\x00" + size + header.encode())
    assert "not a readable .npz file" in refusal(path)


@pytest.mark.parametrize(("offset", "byte"), [(8, 1), (8, 32), (10, 99)])
def test_an_encrypted_patched_or_oddly_packed_archive_is_refused(path, offset, byte):
    content = bytearray(VALID)
    content[content.index(b"PK\x01\x02") + offset] = byte
    path.write_bytes(content)
    assert "not a readable .npz file" in refusal(path)


def test_damaged_compressed_data_is_refused(path):
    content = bytearray(COMPRESSED)
    for position in range(90, 120):
        content[position] ^= 255
    path.write_bytes(content)
    assert "not a readable .npz file" in refusal(path)


def test_an_archive_that_unpacks_to_too_much_is_refused_before_unpacking(path):
    dataset.save(path, make_demos())
    replace_member(path, "obs.npy", bytes(dataset.MAX_BYTES))
    assert path.stat().st_size < 10**6
    assert "allowed: at most" in refusal(path)


def test_flags_that_are_neither_true_nor_false_are_refused(path):
    write_raw(path, {"terminated": np.array([0, 0, 2, 0, 0], np.uint8).view(bool)})
    assert "neither true nor false" in refusal(path)


def test_description_names_task_sizes_success_and_origin():
    text = dataset.describe(make_demos())
    for part in (
        "shape 0",
        "2, 1 successful, 2 to 3 steps, 5 transitions",
        "yaw 1 [rad]",
        "jax 0.10.2",
    ):
        assert part in text
    assert dataset.episode_success(make_demos()).tolist() == [True, False]


def test_demonstrations_are_readable_without_jax():
    code = "import sys, crsfd_jax.demos.dataset; assert not {'jax', 'mujoco'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=30)


BYTES = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8)
PATCHES = (
    st.sampled_from(["obs", "terminated", "provenance"]),
    st.binary(max_size=24),
    st.integers(0, 150),
)


@settings(max_examples=150, deadline=None)
@given(BYTES)
def test_a_file_with_changed_bytes_loads_or_is_refused(tmp_path_factory, changes):
    check_changed_bytes(tmp_path_factory.mktemp("fuzz") / "demos.npz", changes)


def check_changed_bytes(path, changes):
    content = bytearray(VALID if len(changes) % 2 else COMPRESSED)
    for position, byte in changes:
        content[position % len(content)] = byte
    path.write_bytes(content)
    try:
        dataset.load(path, OBS, ACTION)
    except UserError as error:
        assert str(path) in str(error)


@settings(max_examples=120, deadline=None)
@given(*PATCHES)
def test_an_array_with_changed_bytes_and_a_right_checksum_loads_or_is_refused(
    tmp_path_factory, name, patch, position
):
    path = tmp_path_factory.mktemp("fuzz") / "demos.npz"
    check_patched_array(path, name, patch, position)


def check_patched_array(path, name, patch, position):
    path.write_bytes(VALID)
    with zipfile.ZipFile(path) as archive:
        array = archive.read(f"{name}.npy")
    replace_member(path, f"{name}.npy", array[:position] + patch + array[position + len(patch) :])
    try:
        dataset.load(path, OBS, ACTION)
    except UserError as error:
        assert str(path) in str(error)


def _valid_file(write) -> bytes:
    stream = io.BytesIO()
    demos = make_demos()
    arrays = {
        f.name: getattr(demos, f.name)
        for f in dataclasses.fields(Demonstrations)
        if f.name != "provenance"
    }
    text = json.dumps(dataclasses.asdict(demos.provenance))
    write(stream, **arrays, provenance=np.array(text))
    return stream.getvalue()


VALID, COMPRESSED = _valid_file(np.savez), _valid_file(np.savez_compressed)
