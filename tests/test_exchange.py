"""Demonstrations go to other tools' formats and back bit for bit; what does not fit is refused."""

import dataclasses
import json
import re
import shutil

import numpy as np
import pytest

from crsfd_jax import extras
from crsfd_jax.demos import __main__ as demos_cli
from crsfd_jax.demos import builtin, dataset, exchange
from crsfd_jax.errors import UserError

h5py = pytest.importorskip("h5py")
STANDARD = {"actions", "rewards", "dones", "states", "obs", "next_obs"}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    return exchange.export_file(
        "builtin", "robomimic", str(tmp_path_factory.mktemp("export") / "demos.hdf5")
    )


@pytest.fixture
def copy(exported, tmp_path):
    """A file of its own to change, and an importer that returns the refusal."""
    path = tmp_path / "changed.hdf5"
    shutil.copy(exported, path)
    return path


def refusal(source, tmp_path) -> str:
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UserError) as error:
        exchange.import_file(str(source), str(tmp_path / "imported.npz"))
    assert sorted(tmp_path.rglob("*")) == before, "something was written"
    assert str(source) in str(error.value) and "\n" not in str(error.value)
    assert error.value.exit_code == 2
    return str(error.value)


def assert_equal(one, other):
    assert one.provenance == other.provenance
    for field in dataclasses.fields(dataset.Demonstrations):
        if field.name != "provenance":
            before, after = getattr(one, field.name), getattr(other, field.name)
            assert before.dtype == after.dtype
            np.testing.assert_array_equal(before, after)


def test_robomimic_gives_back_every_bit_so_that_a_replay_does_the_same(exported, tmp_path, capsys):
    target = tmp_path / "back.npz"
    assert demos_cli.run(["import", exported, "--out", str(target)]) == 0
    assert_equal(builtin.load(str(target)), builtin.load("builtin"))
    assert target.read_bytes() == builtin.PATH.read_bytes()
    assert str(target) in capsys.readouterr().out


def test_a_run_that_names_an_export_is_told_to_import_it(exported):
    with pytest.raises(UserError, match=r"demo .*hdf5: got .* crsfd_jax.demos import"):
        builtin.load(str(exported))


def test_a_file_with_the_standard_fields_only_comes_back_whole(copy, tmp_path):
    with h5py.File(copy, "a") as file:
        for demo in file["data"].values():
            for name in set(demo) - STANDARD:
                del demo[name]
    imported = exchange.import_file(str(copy), str(tmp_path / "back.npz"))
    assert_equal(imported, builtin.load("builtin"))


def test_the_file_is_laid_out_as_the_loader_of_robomimic_reads_it(exported):
    demos = builtin.load("builtin")
    with h5py.File(exported, "r", swmr=True, libver="latest") as file:
        names = sorted(file["data"], key=lambda name: int(name[5:]))
        assert names == [f"demo_{i}" for i in range(len(demos.episode_length))]
        lengths = [file[f"data/{name}"].attrs["num_samples"] for name in names]
        np.testing.assert_array_equal(lengths, demos.episode_length)
        assert file["data"].attrs["total"] == sum(lengths)
        args = json.loads(file["data"].attrs["env_args"])
        assert set(args) == {"env_name", "type", "env_kwargs"} and args["type"] == 2
        success = [name.decode() for name in file["mask/success"][:]]
        assert success == [names[i] for i in np.flatnonzero(dataset.episode_success(demos))]
        for name, length in zip(names, lengths, strict=True):
            demo = file[f"data/{name}"]
            assert set(demo) >= STANDARD and set(demo["obs"]) == set(demo["next_obs"])
            arrays = [*(demo[n] for n in STANDARD - {"obs", "next_obs"}), *demo["obs"].values()]
            assert {len(array) for array in arrays} == {length}
            assert demo["dones"][-1] == 1 and not demo["dones"][:-1].any()
        start = np.stack([file[f"data/{name}/states"][0, :7] for name in names])
    np.testing.assert_array_equal(start, demos.start_qpos)


def _env_args(file, **changes):
    args = json.loads(file["data"].attrs["env_args"]) | changes
    file["data"].attrs["env_args"] = json.dumps(args)


def _provenance(file, **changes):
    source = json.loads(file["data"].attrs["provenance"]) | changes
    file["data"].attrs["provenance"] = json.dumps(source)


def _images(file):
    for demo in file["data"].values():
        for name in ("obs", "next_obs"):
            del demo[name]
            demo[f"{name}/agentview_image"] = np.zeros((demo.attrs["num_samples"], 2, 2, 3), "u1")


def _seven_actions(file):
    for demo in file["data"].values():
        actions = np.pad(demo["actions"][:], [(0, 0), (0, 1)])
        del demo["actions"]
        demo["actions"] = actions


def _replace(name, value):
    def change(file):
        del file[name]
        file[name] = value

    return change


def _huge(file):
    del file["data/demo_0/actions"]
    file.create_dataset("data/demo_0/actions", (10**9, 6), "f4", chunks=(1024, 6))


def _external_file(file):
    del file["data/demo_0/rewards"]
    file.create_dataset("data/demo_0/rewards", (4,), "f4", external=[("/etc/passwd", 0, 16)])


def _virtual(file):
    layout = h5py.VirtualLayout((4,), "f4")
    layout[:] = h5py.VirtualSource("/etc/passwd", "x", (4,))
    del file["data/demo_0/rewards"]
    file.create_virtual_dataset("data/demo_0/rewards", layout)


def _loop(file):
    file["data/demo_0/again"] = file["data"]


FIRST = builtin.load("builtin").episode_length[0]
NESTED = {"robots": ["Sawyer"]}
UNFIT = {
    "other robot": (
        lambda f: _env_args(f, env_name="Lift", env_kwargs=NESTED),
        r"recorded in Lift with \['Sawyer'\], expected crsfd/Insertion-v0",
    ),
    "other rate": (lambda f: _provenance(f, control_dt_s=0.05), "0.05 s, expected 0.1 s"),
    "other frequency": (
        lambda f: _env_args(f, env_kwargs={"control_freq": 20}),
        "at 20 Hz, expected 10 Hz",
    ),
    "other scale": (lambda f: _provenance(f, action_scale=[1.0] * 6), "action scale"),
    "other shape": (lambda f: _provenance(f, shape="9"), "shape: got '9'"),
    "other actions": (_seven_actions, r"actions is \(\d+, 7\), expected \(T, 6\)"),
    "images only": (_images, "lacks joint_position.*agentview_image, images only"),
    "missing field": (
        lambda f: f.__delitem__("data/demo_3/obs/tip_velocity"),
        "demo_3/obs lacks tip_velocity",
    ),
    "missing states": (lambda f: f.__delitem__("data/demo_3/states"), "states is missing"),
    "no provenance": (
        lambda f: f["data"].attrs.__delitem__("provenance"),
        "lacks the attribute provenance",
    ),
    "a column short": (
        lambda f: _provenance(f, obs_layout=builtin.load("builtin").provenance.obs_layout[1:]),
        "provenance.obs_layout has 28 entries, expected 29",
    ),
    "an action short": (
        lambda f: _provenance(f, action_scale=[0.01] * 5),
        "provenance.action_scale has 5 entries, expected 6",
    ),
    "an episode that is an array": (
        _replace("data/demo_3", np.zeros(3, "f4")),
        "data holds demo_3, expected the groups",
    ),
    "no env_args": (lambda f: f["data"].attrs.__delitem__("env_args"), "env_args is no JSON"),
    "no data": (lambda f: f.__delitem__("data"), "lacks the group data"),
    "odd name": (lambda f: f.move("data/demo_3", "data/demo_x"), "data holds demo_x"),
    "short field": (
        _replace("data/demo_2/rewards", np.zeros(1, "f4")),
        "episode 2: obs is float32",
    ),
    "loud action": (
        _replace("data/demo_0/actions", np.full((FIRST, 6), 9.0, "f4")),
        r"values of action outside \[-1, 1\]",
    ),
    "not a number": (
        _replace("data/demo_0/rewards", np.full(FIRST, np.nan, "f4")),
        "non-finite values, first at reward",
    ),
    "soft link": (
        _replace("data/demo_0/rewards", h5py.SoftLink("/data/demo_1/rewards")),
        "soft or external link; refused",
    ),
    "external link": (
        _replace("data/demo_0/rewards", h5py.ExternalLink("/etc/passwd", "/x")),
        "soft or external link; refused",
    ),
    "external storage": (_external_file, "keeps its values in other files; refused"),
    "virtual": (_virtual, "keeps its values in other files; refused"),
    "too large": (_huge, "declares 24000000000 bytes"),
    "text of any length": (
        _replace("data/demo_0/rewards", np.array(["a"], h5py.string_dtype())),
        "holds object, allowed: numbers; refused",
    ),
    "references": (
        lambda f: f.create_dataset("data/demo_0/r", data=f["data"].ref, dtype=h5py.ref_dtype),
        "holds object, allowed: numbers; refused",
    ),
    "compound": (
        _replace("data/demo_0/rewards", np.zeros(2, [("a", "f4"), ("b", "i4")])),
        "allowed: numbers; refused",
    ),
    "loop": (_loop, "nested more than 8 deep; refused"),
}


@pytest.mark.parametrize("case", UNFIT)
def test_what_does_not_fit_is_refused_with_its_reason_before_anything_is_written(
    case, copy, tmp_path
):
    change, reason = UNFIT[case]
    with h5py.File(copy, "a") as file:
        change(file)
    text = refusal(copy, tmp_path)
    assert re.search(reason, text), text


@pytest.mark.parametrize("content", [b"", b"no hdf5", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_bytes_that_are_no_hdf5_are_refused(content, tmp_path):
    path = tmp_path / "bad.hdf5"
    path.write_bytes(content)
    assert "not a readable HDF5 file" in refusal(path, tmp_path)


def test_a_file_cut_short_is_refused(copy, tmp_path):
    copy.write_bytes(copy.read_bytes()[:-2000])
    assert "not a readable HDF5 file" in refusal(copy, tmp_path)


def test_a_missing_file_is_named(tmp_path):
    assert "no such file" in refusal(tmp_path / "absent.hdf5", tmp_path)


def test_existing_files_are_not_overwritten(exported, tmp_path):
    target = tmp_path / "there"
    target.write_text("mine")
    for call in (
        lambda: exchange.import_file(exported, str(target)),
        lambda: exchange.export_file("builtin", "robomimic", str(target)),
    ):
        with pytest.raises(UserError, match="which exists"):
            call()
    assert target.read_text() == "mine"


@pytest.mark.parametrize("source", ["demos.hdf5", "minari:crsfd/x-v0"])
def test_a_missing_package_is_named_with_its_extra(source, monkeypatch, tmp_path):
    monkeypatch.setattr(extras.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"h5py.*pip install -e '\.\[data\]'"):
        exchange.import_file(source, str(tmp_path / "out.npz"))


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A local store of Minari with the shipped demonstrations in it."""
    pytest.importorskip("minari")
    folder = tmp_path_factory.mktemp("store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        assert demos_cli.run(["export", "--format", "minari", "--out", "crsfd/zero-v0"]) == 0
        yield folder


def test_minari_gives_back_every_bit(store, tmp_path):
    target = tmp_path / "back.npz"
    assert_equal(exchange.import_file("minari:crsfd/zero-v0", str(target)), builtin.load("builtin"))
    assert target.read_bytes() == builtin.PATH.read_bytes()


def test_minari_itself_reads_the_episodes(store):
    import minari

    demos = builtin.load("builtin")
    stored = minari.load_dataset("crsfd/zero-v0")
    assert (stored.total_episodes, stored.total_steps) == (40, len(demos.obs))
    first = stored[0]
    assert stored.observation_space.contains(first.observations[0])
    assert stored.action_space.contains(first.actions[0])
    length = demos.episode_length[0]
    np.testing.assert_array_equal(first.observations[1:], demos.next_obs[:length])
    np.testing.assert_array_equal(first.terminations, demos.terminated[:length])


@pytest.mark.filterwarnings("ignore")
def test_a_data_set_of_another_robot_is_refused(store, tmp_path):
    import gymnasium
    import minari
    from minari.data_collector import EpisodeBuffer

    box = gymnasium.spaces.Box(-1, 1, (4,), np.float32)
    buffer = EpisodeBuffer(
        observations=np.zeros((3, 4), "f4"),
        actions=np.zeros((2, 4), "f4"),
        rewards=np.zeros(2),
        terminations=np.array([False, True]),
        truncations=np.zeros(2, bool),
    )
    minari.create_dataset_from_buffers(
        "other/robot-v0", [buffer], observation_space=box, action_space=box
    )
    text = refusal("minari:other/robot-v0", tmp_path)
    assert "observation_space is Box [4], expected Box [29]: another robot" in text


def test_a_data_set_that_would_start_an_environment_is_refused(store, tmp_path, monkeypatch):
    shutil.copytree(store, tmp_path / "store")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "store"))
    path = tmp_path / "store/crsfd/zero-v0/data/metadata.json"
    metadata = json.loads(path.read_text())
    del metadata["action_space"]
    path.write_text(json.dumps(metadata | {"env_spec": json.dumps({"id": "evil/Env-v0"})}))
    assert "recorded in evil/Env-v0" in refusal("minari:crsfd/zero-v0", tmp_path)
    path.write_text(json.dumps(metadata))
    assert "action_space is no JSON" in refusal("minari:crsfd/zero-v0", tmp_path)


@pytest.mark.parametrize("name", ["crsfd/absent-v0", "../../etc", "a b"])
def test_a_data_set_that_is_not_there_is_named(store, name, tmp_path):
    refusal(f"minari:{name}", tmp_path)


def test_a_data_set_with_links_is_refused(store, tmp_path, monkeypatch):
    shutil.copytree(store, tmp_path / "store")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "store"))
    with h5py.File(tmp_path / "store/crsfd/zero-v0/data/main_data.hdf5", "a") as file:
        del file["episode_0/rewards"]
        file["episode_0/rewards"] = h5py.ExternalLink("/etc/passwd", "/x")
    assert "soft or external link; refused" in refusal("minari:crsfd/zero-v0", tmp_path)


def test_an_existing_data_set_is_kept(store):
    with pytest.raises(UserError, match="which exists"):
        exchange.export_file("builtin", "minari", "crsfd/zero-v0")
