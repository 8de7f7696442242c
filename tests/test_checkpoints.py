"""Checkpoints: bit-exact, and a damaged one is never taken for a good one."""

import errno
import hashlib
import json
import os
import shutil

import jax
import jax.numpy as jnp
import pytest

from crsfd_jax.errors import UserError
from crsfd_jax.storage import checkpoints
from crsfd_jax.storage.leaves import stored_bytes


def make_state(seed: int):
    key = jax.random.key(seed)
    return {
        "params": {"kernel": jax.random.normal(key, (40, 50)), "bias": jnp.zeros(3, jnp.bfloat16)},
        "keys": jax.random.split(key, 3),
        "fast_key": jax.random.key(seed, impl="rbg"),
        "step": jnp.int32(seed),
        "flags": jnp.array([True, False]),
        "nothing": jnp.zeros((0, 4)),
    }


def bits(state):
    leaves, structure = jax.tree.flatten(state)
    plain = [
        jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x
        for x in leaves
    ]
    return structure, [
        (str(x.dtype), p.shape, p.tobytes()) for x, p in zip(leaves, plain, strict=True)
    ]


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "checkpoints"


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "checkpoints"
    for step in (1, 2):
        checkpoints.save(folder, step, make_state(step), {"at": step})
    return folder


def test_a_state_comes_back_bit_for_bit_with_types_keys_and_empty_arrays(saved):
    restored = checkpoints.restore(saved, make_state(0))
    assert restored is not None
    assert (restored.step, restored.extra) == (2, {"at": 2})
    assert bits(restored.state) == bits(make_state(2))
    assert not restored.state["step"].committed
    draw = jax.random.normal(restored.state["fast_key"], ())
    assert draw == jax.random.normal(make_state(2)["fast_key"], ())


def test_the_structure_may_be_given_by_shapes_alone(folder):
    state = {"key": jax.random.key(7), "x": jnp.arange(4.0)}
    checkpoints.save(folder, 5, state, {})
    restored = checkpoints.restore(folder, jax.eval_shape(lambda: state))
    assert restored is not None and bits(restored.state) == bits(state)
    assert not restored.state["x"].committed


def test_no_checkpoint_is_no_error(folder):
    assert checkpoints.restore(folder, make_state(0)) is None
    folder.mkdir()
    assert checkpoints.restore(folder, make_state(0)) is None


def test_the_newest_two_are_kept_and_a_step_may_be_saved_again(folder):
    for step in (8, 9, 10):
        checkpoints.save(folder, step, {"x": jnp.full(3, step)}, {})
    checkpoints.save(folder, 10, {"x": jnp.full(3, 11)}, {})
    assert sorted(entry.name for entry in folder.iterdir()) == ["10", "9"]
    restored = checkpoints.restore(folder, {"x": jnp.zeros(3, int)})
    assert restored is not None and restored.state["x"].tolist() == [11, 11, 11]


def test_the_size_of_a_state_counts_every_leaf_as_it_is_stored():
    state = {"x": jnp.zeros((3, 5)), "k": jax.random.split(jax.random.key(0), 4), "e": jnp.zeros(0)}
    assert stored_bytes(jax.eval_shape(lambda: state)) == 3 * 5 * 4 + 4 * 2 * 4


def test_another_structure_is_refused_by_leaf_and_the_checkpoint_stays(saved):
    for name, leaf in (
        ("step", jnp.float32(0)),
        ("flags", jnp.zeros(3, bool)),
        ("new", jnp.zeros(1)),
    ):
        with pytest.raises(UserError, match=name):
            checkpoints.restore(saved, make_state(0) | {name: leaf})
    assert (saved / "2").is_dir()


def damage(path, how):
    content = path.read_bytes()
    middle = len(content) // 2
    if how == "delete":
        path.unlink()
    elif how == "truncate":
        path.write_bytes(content[:middle])
    elif how == "zero":
        path.write_bytes(bytes(len(content)))
    else:
        path.write_bytes(content[:middle] + bytes([content[middle] ^ 4]) + content[middle + 1 :])


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_no_damage_to_any_file_is_taken_for_the_saved_state(saved, folder, caplog):
    files = [p.relative_to(saved) for p in sorted((saved / "2").rglob("*")) if p.is_file()]
    files = [file for file in files if (saved / file).stat().st_size]
    fallbacks = 0
    for file in files:
        for how in ("flip", "truncate", "zero", "delete"):
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(saved, folder)
            damage(folder / file, how)
            restored = checkpoints.restore(folder, make_state(0))
            assert restored is not None
            assert bits(restored.state) == bits(make_state(restored.step))
            assert restored.extra == {"at": restored.step}
            fallbacks += restored.step == 1
            assert (folder / "2.damaged").exists() == (restored.step == 1)
    assert fallbacks > len(files)
    assert "checkpoint 2 is damaged" in caplog.text


def test_a_stray_numbered_folder_is_set_aside_and_the_rest_is_ignored(saved, folder):
    shutil.copytree(saved, folder)
    for name in ("99", "notes", "7.orbax-checkpoint-tmp", "3.trash"):
        (folder / name).mkdir()
    restored = checkpoints.restore(folder, make_state(0))
    assert restored is not None and restored.step == 2
    assert {p.name for p in folder.iterdir()} == {"1", "2", "99.damaged", "notes"}


def test_a_run_never_starts_afresh_in_silence_when_all_checkpoints_are_damaged(saved, folder):
    shutil.copytree(saved, folder)
    for step in ("1", "2"):
        shutil.rmtree(folder / step / "d")
    for _ in range(2):
        with pytest.raises(UserError, match=r"1.damaged, 2.damaged"):
            checkpoints.restore(folder, make_state(0))


def test_a_failed_save_is_one_error_and_the_older_checkpoint_stays(folder, monkeypatch):
    checkpoints.save(folder, 1, {"x": jnp.ones(3)}, {})

    def full_disk(*_, **__):
        (folder / "2.orbax-checkpoint-tmp").mkdir()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints.array_store, "save", full_disk)
    with pytest.raises(UserError, match=r"checkpoint 2 cannot be written .no space left"):
        checkpoints.save(folder, 2, {"x": jnp.zeros(3)}, {})
    assert [entry.name for entry in folder.iterdir()] == ["1"]
    restored = checkpoints.restore(folder, {"x": jnp.zeros(3)})
    assert restored is not None and restored.state["x"].tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    "body",
    [
        *("[]", "3", "{}", '{"leaves": 3}', '{"leaves": {"a": 1}}', '{"extra": 7}', "{"),
        '{"leaves": {"[\'x\']": {"type": "key<fry>[]", "implementation": "os", "sha256": "0"}}}',
    ],
)
def test_a_forged_description_with_a_right_digest_can_do_no_more_than_be_refused(folder, body):
    checkpoints.save(folder, 1, {"x": jax.random.key(0)}, {})
    file = folder / "1" / "_CHECKPOINT_METADATA"
    description = json.loads(file.read_text())
    sha256 = hashlib.sha256(body.encode()).hexdigest()
    description["custom_metadata"] = {"body": body, "sha256": sha256}
    file.write_text(json.dumps(description))
    with pytest.raises(UserError):
        checkpoints.restore(folder, {"x": jax.random.key(0)})


def test_the_order_of_checkpoints_is_that_of_their_steps_whatever_the_clock_says(folder):
    for step in (1, 2, 3):
        checkpoints.save(folder, step, {"x": jnp.full(3, step)}, {})
        past = 2_000_000_000 - 10**8 * step
        for entry in (folder / str(step), *(folder / str(step)).rglob("*")):
            os.utime(entry, (past, past))
    assert sorted(entry.name for entry in folder.iterdir()) == ["2", "3"]
    restored = checkpoints.restore(folder, {"x": jnp.zeros(3, int)})
    assert restored is not None and restored.step == 3


@pytest.mark.parametrize(
    "lack",
    [
        MemoryError(),
        jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory"),
        OSError(errno.EMFILE, "Too many open files"),
    ],
    ids=lambda lack: type(lack).__name__,
)
def test_what_the_machine_lacks_is_not_taken_for_damage(saved, tmp_path, monkeypatch, lack):
    folder = shutil.copytree(saved, tmp_path / "checkpoints")

    def fail(*_):
        raise lack

    with monkeypatch.context() as patch, pytest.raises(type(lack)):
        patch.setattr(checkpoints, "from_numpy", fail)
        checkpoints.restore(folder, make_state(0))
    assert checkpoints.restore(folder, make_state(0)).step == 2
