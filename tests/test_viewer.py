"""The browser viewer: what its controls do, what a person records, and the page itself."""

import contextlib
import dataclasses
import threading

import browser
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from crsfd_jax import config, env, view
from crsfd_jax.demos import builtin, dataset, replay
from crsfd_jax.drawing import video
from crsfd_jax.errors import UserError
from crsfd_jax.learn import networks
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.options.randomisation import Randomisation
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.scene.build import model_of
from crsfd_jax.viewer import hand, live, panel, pose, potential_map, serve, session, tape

OPTIONS = config.Config(seeds=2, seed=7, engine="native", sac=config.Sac(hidden=(8,)))
SOURCE = live.Task("2", 0.0, 1.0)


@pytest.fixture(scope="module")
def loaded():
    """Untrained policies: nothing here depends on what they do."""
    nets = networks.make_networks(OPTIONS.sac, ACTION_SIZE)
    keys = jax.random.split(jax.random.key(0), OPTIONS.seeds)
    return live.make(OPTIONS, jax.vmap(lambda key: nets.actor.init(key, jnp.zeros(OBS_SIZE)))(keys))


def bump(poses):
    """A potential whose largest value lies at x = 2 cm, y = -1 cm."""
    centre = np.array([0.02, -0.01])
    return np.exp(-np.sum((poses[..., :2] - centre) ** 2, axis=-1) / 0.01**2)


@pytest.fixture(scope="module")
def served(loaded):
    """A page with its server, and nothing that waits."""
    viser = pytest.importorskip("viser")
    pytest.importorskip("mjviser")
    from crsfd_jax.viewer import drawing, session

    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    drawn = drawing.make(server, loaded.scene, "2", potential_map.over_mouth(bump))
    page = session.start(loaded, drawn, panel.make(server, loaded, SOURCE), 0)
    yield page
    server.stop()


@pytest.fixture
def page(served):
    """The page as it was at first."""
    controls = served.panel
    controls.by_hand.value = controls.paused.value = False
    controls.shape.value, controls.shift.value, controls.friction.value = SOURCE
    controls.seed.value, controls.speed.value, controls.forces.value = "7", 1.0, True
    served.tape.forget()
    served.tape.is_running, served.message = False, ""
    controls.asked.put(("reset", None))
    step(served)
    return served


def step(page, count=1):
    from crsfd_jax.viewer import session

    for _ in range(count):
        session.step(page, sleep=lambda seconds: None)


def test_each_seed_has_its_own_policy(loaded):
    state = loaded.reset(SOURCE, jax.random.key(3))
    actions = [np.asarray(loaded.act(loaded.actors, row, state)) for row in range(2)]
    assert actions[0].shape == (1, ACTION_SIZE) and not np.array_equal(*actions)


def test_a_fresh_episode_has_the_shape_offset_and_friction_asked_for(loaded):
    wanted = live.Task("3", 0.008, 0.4)
    states = [loaded.reset(wanted, jax.random.key(i)) for i in range(20)]
    offsets = np.concatenate([state.around.socket_offset for state in states])
    assert {int(state.around.shape[0]) for state in states} == {loaded.scene.shapes.index("3")}
    assert {float(state.around.friction[0]) for state in states} == {np.float32(0.4)}
    assert 0.003 < np.abs(offsets).max() <= 0.004 and len(np.unique(offsets)) == 40


def test_without_a_friction_of_its_own_an_episode_has_one_of_training():
    arm = Randomisation(friction=(2.0, 2.5))
    shown = live.make(dataclasses.replace(OPTIONS, randomisation=arm), None)
    states = [shown.reset(live.task_of(shown, "2", 0.0), jax.random.key(i)) for i in range(5)]
    drawn = {float(state.around.friction[0]) for state in states}
    assert len(drawn) == 5 and min(drawn) >= 2.0 and max(drawn) <= 2.5


def test_a_delayed_arm_is_drawn_as_pulled_by_the_setpoint_before():
    arm = Randomisation(delay=1.0)
    shown = live.make(dataclasses.replace(OPTIONS, randomisation=arm), None)
    state, action = shown.reset(SOURCE, jax.random.key(0)), jnp.full((1, 6), 0.5)
    asked = env.setpoint(OPTIONS.mdp, state.tip, action)[0]
    first = shown.advance(state, action)
    np.testing.assert_allclose(first.setpoint, state.tip[0], atol=1e-6)
    np.testing.assert_allclose(shown.advance(first.state, action).setpoint, asked, atol=1e-6)


@pytest.mark.parametrize(
    "name", ["a" * 300 + ".npz", "a\0.npz", "<img src=x>.npz", "../a.npz", ".npz", "a.txt"]
)
def test_a_recording_is_saved_under_a_plain_name_only(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    said = tape.Tape().save(name, OPTIONS, "2", 0.0)
    assert said.startswith("allowed is a name such as by_hand.npz") and not any(tmp_path.iterdir())


def test_what_a_page_says_is_no_markup(page):
    page.message = "<img src=x>"
    session._report(page)
    assert "&lt;img src=x&gt;" in page.panel.status.content


def test_no_potential_is_shown_of_a_method_without_one(monkeypatch, capsys):
    monkeypatch.setattr(serve.shown_potential, "fit", lambda _: (bump, None))
    shown = serve._potential(dataclasses.replace(OPTIONS, algorithm="crsfd_same_gamma"))
    none = serve._potential(dataclasses.replace(OPTIONS, algorithm="rsgm"))
    assert len(np.unique(shown.reshape(-1, shown.shape[-1]), axis=0)) > 100
    assert len(np.unique(none.reshape(-1, none.shape[-1]), axis=0)) < 100
    assert "no potential is shown: rsgm has none" in capsys.readouterr().out


def test_a_step_moves_the_arm_that_is_drawn(page):
    tip = page.drawing.scene.model.site("tip").id
    before = page.drawing.data.site_xpos[tip].copy()
    step(page, 3)
    assert page.age == 4
    assert np.linalg.norm(page.drawing.data.site_xpos[tip] - before) > 1e-4
    np.testing.assert_allclose(page.drawing.data.qpos, page.state.physics.qpos[0], atol=1e-6)


def test_pause_stops_the_arm_and_reset_begins_anew(page):
    step(page, 3)
    page.panel.paused.value = True
    qpos = np.asarray(page.state.physics.qpos)
    step(page, 3)
    np.testing.assert_array_equal(page.state.physics.qpos, qpos)
    page.panel.asked.put(("reset", None))
    step(page)
    assert page.age == 0 and not np.array_equal(page.state.physics.qpos, qpos)


def test_another_shape_replaces_peg_and_socket_in_scene_and_simulation(page):
    scene, model = page.drawing.scene, page.drawing.arm.mj_model
    page.panel.shape.value = "4"
    step(page)
    np.testing.assert_array_equal(model.geom_pos, model_of(scene, scene.shapes.index("4")).geom_pos)
    assert int(page.state.around.shape[0]) == scene.shapes.index("4")
    assert page.drawing.name.text == "socket 4" and page.age == 1


def test_shift_moves_the_socket_that_is_drawn(page):
    page.panel.shift.value = 20.0
    step(page)
    moved = page.drawing.data.mocap_pos[0] - page.drawing.scene.nominal
    np.testing.assert_allclose(moved[:2], page.state.around.socket_offset[0], atol=1e-7)
    assert 0 < np.abs(moved[:2]).max() <= 0.01


def test_friction_changes_without_a_fresh_episode(page):
    step(page, 2)
    page.panel.friction.value = 0.3
    step(page)
    assert page.age == 4 and float(page.state.around.friction[0]) == np.float32(0.3)
    drawn = page.drawing.arm.mj_model.geom_friction[page.drawing.scene.look_parts, 0]
    assert set(drawn) == {np.float32(0.3)}


def test_the_seed_chooses_the_policy(page, monkeypatch):
    rows = []
    act = page.live.act

    def noted(actors, row, state):
        rows.append(row)
        return act(actors, row, state)

    monkeypatch.setattr(page, "live", page.live._replace(act=noted))
    step(page)
    page.panel.seed.value = "8"
    step(page)
    assert rows == [0, 1]


def test_speed_is_the_time_that_a_step_is_given(page, monkeypatch):
    from crsfd_jax.viewer import session

    # However slow the machine is, drawing takes no time.
    monkeypatch.setattr(session.time, "perf_counter", lambda: 0.0)
    for speed, expected in ((1.0, CONTROL_DT), (0.1, 10 * CONTROL_DT)):
        page.panel.speed.value, slept = speed, []
        session.step(page, sleep=slept.append)
        assert len(slept) == session.FRAMES and 0.3 * expected <= sum(slept) <= expected + 1e-6


def test_an_episode_ends_at_the_horizon_and_is_counted(page):
    played, inserted = page.played, page.inserted
    step(page, OPTIONS.mdp.horizon)
    assert (page.played, page.inserted) == (played + 1, inserted) and page.age == 1


def forces_on_the_peg(page):
    """[contacts, 3] N along the world's axes, of the contacts that push."""
    model, data, found = page.drawing.arm.mj_model, page.drawing.data, []
    for i, contact in enumerate(data.contact):
        force = np.zeros(6)
        mujoco.mj_contactForce(model, data, i, force)
        is_first = model.geom_bodyid[contact.geom[0]] == model.body("peg").id
        found.append(contact.frame.reshape(3, 3).T @ force[:3] * (-1 if is_first else 1))
    return np.array([force for force in found if np.linalg.norm(force) > 0])


def steady_push(loaded, friction, down):
    """N upwards on the peg, drawn while a setpoint `down` cm below it pushes it onto the block."""
    state = loaded.reset(SOURCE._replace(friction=friction), jax.random.key(1))
    for _ in range(20):
        taken = loaded.advance(state, jnp.array([[0.1, 0, -down, 0, 0, 0]]))
        before, state = state, taken.state
    (at,) = pose.between(before, state, taken.setpoint, 1)
    model = model_of(loaded.scene, loaded.scene.shapes.index("2"))
    data, force, pushed = mujoco.MjData(model), np.zeros(6), 0.0
    pose.put(model, data, at, loaded.scene)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        pushed += force[0]
    return pushed


@pytest.mark.parametrize("friction", [0.1, 1.0, 3.0])
def test_a_steady_push_shows_as_such_under_any_friction(loaded, friction):
    assert steady_push(loaded, friction, 1.0) == pytest.approx(10, rel=0.05)


def test_the_push_of_a_stiffer_arm_shows_as_such():
    arm = Randomisation(stiffness=(1.3, 1.3))
    stiffer = live.make(dataclasses.replace(OPTIONS, randomisation=arm), None)
    # Half a centimetre, or the controller's limit of 10 N would hide the stiffness.
    assert steady_push(stiffer, 1.0, 0.5) == pytest.approx(6.5, rel=0.05)


def shown_arrows(page):
    """Handles of what mjviser draws for contacts, without the heads of the arrows."""
    handles = page.drawing.arm._decor_handles
    return [
        h
        for (kind, _), h in handles.items()
        if h.visible and kind >= int(mujoco.mjtGeom.mjGEOM_ARROW)
    ]


def matrix_of(wxyz):
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(wxyz, float))
    return matrix.reshape(3, 3)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_a_pressed_peg_shows_the_contact_forces(page):
    page.panel.by_hand.value = True
    step(page)
    page.drawing.goal.position = page.drawing.scene.nominal + np.array([0.03, 0.03, -0.01])
    step(page, 30)
    forces, (shafts,) = forces_on_the_peg(page), shown_arrows(page)
    assert len(forces) > 3 and sum(forces)[2] > 5
    seen_length, head = 0.8, 0.2
    lengths = shafts.batched_scales[:, 2] * (1 + head / seen_length)
    np.testing.assert_allclose(lengths, np.linalg.norm(forces, axis=1) * 0.02, rtol=1e-3)
    upwards = [matrix_of(wxyz)[2, 2] for wxyz in shafts.batched_wxyzs]
    np.testing.assert_allclose(upwards, unit(forces)[:, 2], atol=1e-3)
    assert page.drawing.peg.opacity < 1
    page.panel.forces.value = False
    step(page)
    assert not shown_arrows(page) and page.drawing.peg.opacity == 1


def test_the_potential_lies_where_its_poses_are():
    picture = potential_map.over_mouth(bump)
    side = len(picture)
    row, column = np.unravel_index(np.argmax(picture[..., :3].sum(axis=-1)), (side, side))
    metres = (np.array([column, row]) + 0.5) / side * potential_map.SIDE - potential_map.SIDE / 2
    np.testing.assert_allclose(metres, (0.02, -0.01), atol=1.5e-3)
    assert picture.shape == (side, side, 4)


def test_an_action_by_hand_goes_towards_its_goal_and_no_further():
    tip = np.array([0.0, 0.0, 0.05, 0, 0, 0])
    goal = np.array([0.004, -0.5, 0.05, 0.025, 0, 0])
    action = hand.action_towards(config.Mdp(), tip, goal)
    np.testing.assert_allclose(action, [[0.4, -1, 0, 0.5, 0, 0]], atol=1e-6)
    assert action.dtype == np.float32


def drive(page, path, steps):
    """Moves the goal along a path of positions in the nominal socket's frame."""
    for goal in path:
        page.drawing.goal.position = page.drawing.scene.nominal + np.asarray(goal, float)
        page.drawing.goal.wxyz = (1.0, 0.0, 0.0, 0.0)
        for _ in range(steps):
            step(page)
            if page.tape.episodes:
                return


def test_what_a_person_records_is_a_file_that_replays(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page.panel.shape.value, page.panel.friction.value = "1", 0.5
    step(page)
    page.panel.asked.put(("recording", None))
    step(page)
    assert page.panel.by_hand.value and page.panel.friction.value == 1.0
    drive(page, [(0, 0, 0.02), (0, 0, -0.05)], 40)
    assert len(page.tape.episodes) == 1, "the peg was not inserted"
    step(page, 2)
    page.panel.asked.put(("recording", None))
    step(page)
    assert len(page.tape.episodes) == 2 and not page.tape.is_running
    page.panel.file.value = "mine.npz"
    page.panel.asked.put(("save", None))
    step(page)
    assert page.message == "2 episodes written to mine.npz"
    demos = builtin.load("mine.npz")
    assert demos.provenance.expert == "recorded by hand" and demos.provenance.shape == "1"
    np.testing.assert_array_equal(dataset.episode_success(demos), [True, False])
    played = replay.replay(demos, "native")
    np.testing.assert_array_equal(played.success, [True, False])
    assert played.deviation.max() < 1e-4


def test_a_save_leaves_the_episode_that_goes_on_alone(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page.panel.shape.value = "1"
    page.panel.asked.put(("recording", None))
    step(page)
    drive(page, [(0, 0, 0.02), (0, 0, -0.05)], 40)
    step(page, 5)
    page.panel.file.value = "mine.npz"
    page.panel.asked.put(("save", None))
    step(page, 2)
    assert page.message == "1 episodes written to mine.npz"
    page.panel.asked.put(("recording", None))
    step(page)
    demos = hand.demonstrations(page.tape.episodes, page.live.config, "1", 0.0, "")
    assert demos.episode_length[1] > 5
    np.testing.assert_array_equal(demos.obs[demos.episode_length[0]][7:14], 0, "starts at rest")


def test_friction_and_driver_stay_while_a_person_records(page):
    page.panel.asked.put(("recording", None))
    step(page, 2)
    page.panel.friction.value, page.panel.by_hand.value = 0.3, False
    step(page)
    assert page.panel.friction.value == 1.0 and page.panel.by_hand.value
    assert float(page.state.around.friction[0]) == 1.0 and len(page.tape.steps) == 3


@pytest.mark.parametrize("name", ["../x.npz", "/tmp/x.npz", "x.txt", "there.npz", "fresh.npz"])
def test_a_recording_is_saved_nowhere_else_and_over_nothing(page, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.npz").write_text("mine")
    page.panel.file.value = name
    page.panel.asked.put(("save", None))
    step(page)
    assert "written" not in page.message and page.message
    assert [path.name for path in tmp_path.iterdir()] == ["there.npz"]
    assert (tmp_path / "there.npz").read_text() == "mine"


def test_a_key_nudges_the_goal(page):
    page.panel.by_hand.value = True
    step(page)
    before = np.array(page.drawing.goal.position)
    page.panel.asked.put(("move", (2, -0.005)))
    page.panel.paused.value = True
    step(page)
    np.testing.assert_allclose(page.drawing.goal.position - before, [0, 0, -0.005], atol=1e-9)


def test_the_address_comes_with_the_way_to_it_over_ssh():
    text = serve.hint("127.0.0.1", 8123)
    assert "http://localhost:8123" in text and "ssh -L 8123:localhost:8123 " in text


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (["absent"], "absent: holds no config.json"),
        (["--video", "out.mp4"], "--video: got no run"),
        (["run", "--video", "out.avi"], r"--video: got 'out.avi', allowed: .*\.gif or \.mp4"),
        (["run", "--video", "absent/out.gif"], "allowed: a folder that exists"),
        (["run", "--port", "0"], "--port: got 0, allowed"),
        (["run", "--shape", "0,1"], "--shape: got '0,1', allowed here: one shape"),
    ],
)
def test_a_line_that_cannot_be_used_is_refused(line, reason):
    with pytest.raises(UserError, match=reason) as error:
        view.main(line)
    assert "\n" not in str(error.value)


def test_a_taken_port_is_named():
    import socket

    pytest.importorskip("mjviser")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=f"--port: got 127.0.0.1:{port}, allowed: a free one"):
            serve.watch("run", None, None, "127.0.0.1", port)


@pytest.mark.filterwarnings("ignore:os.fork")
def test_an_mp4_gives_its_frames_back(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    import imageio.v3

    frames = [np.full((48, 64, 3), shade, np.uint8) for shade in (20, 120, 220) for _ in range(5)]
    video.write(tmp_path / "run.mp4", frames, 0.05)
    read = imageio.v3.imread(tmp_path / "run.mp4", plugin="FFMPEG")
    assert read.shape == (15, 48, 64, 3)
    assert imageio.v3.immeta(tmp_path / "run.mp4", plugin="FFMPEG")["fps"] == 20
    np.testing.assert_allclose(
        read.mean(axis=(1, 2, 3)), np.stack(frames).mean(axis=(1, 2, 3)), atol=4
    )


@pytest.mark.skipif(browser.find() is None, reason="no Chromium is installed")
def test_a_browser_draws_the_scene_and_follows_its_controls(page, tmp_path):
    """The arm stands still, so that pictures differ by what a control changed only."""
    page.panel.paused.value, page.panel.forces.value = True, False
    with running(page), in_a_browser(page, tmp_path) as tab:
        _follow(page, tab)


@contextlib.contextmanager
def running(page):
    """What goes on behind the page, in a thread."""
    from crsfd_jax.viewer import session

    stop = threading.Event()

    def run():
        while not stop.is_set():
            session.step(page)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@contextlib.contextmanager
def in_a_browser(page, folder):
    url = f"http://127.0.0.1:{page.drawing.server.get_port()}"
    with browser.opened(url, folder, 900, 600) as tab:
        drawn = "!!document.querySelector('canvas')"
        browser.wait_for(lambda: bool(tab.evaluate(drawn)), 60, "canvas")
        yield tab


@pytest.mark.skipif(browser.find() is None, reason="no Chromium is installed")
def test_a_demonstration_is_recorded_with_the_keyboard_of_a_browser(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page.panel.speed.value, page.panel.file.value = 4.0, "by_hand.npz"
    with running(page), in_a_browser(page, tmp_path / "profile") as tab:
        browser.wait_for(lambda: tab.has_button("Start recording"), 60, "the panel")
        tab.click("Start recording")
        browser.wait_for(lambda: bool(page.tape.steps), 60, "recording")
        goal = page.drawing.goal.position - page.drawing.scene.nominal
        for axis, plus, minus in ((0, "I", "K"), (1, "J", "L")):
            coarse, fine = divmod(round(abs(goal[axis]) / panel.FINE), 10)
            key = plus if goal[axis] < 0 else minus
            for is_fine in [False] * coarse + [True] * fine:
                tab.press(key, is_fine)

        def is_above(pose, tolerance):
            return np.abs(pose[:2]).max() < tolerance and abs(pose[2] - goal[2]) < 1e-3

        def moved():
            return page.drawing.goal.position - page.drawing.scene.nominal

        browser.wait_for(lambda: is_above(moved(), panel.FINE / 2 + 1e-6), 30, "the goal")
        browser.wait_for(lambda: is_above(np.asarray(page.state.tip)[0], 1e-3), 60, "the peg")
        for _ in range(30):
            if not page.tape.episodes:
                tab.press("O", False)
        browser.wait_for(lambda: bool(page.tape.episodes), 60, "an episode")
        tab.click("Stop recording")
        browser.wait_for(lambda: not page.tape.is_running, 60, "stopped")
        tab.click("Save")
        browser.wait_for(lambda: "written to by_hand.npz" in tab.text(), 60, "what was saved")
    demos = builtin.load("by_hand.npz")
    assert dataset.episode_success(demos)[0]
    assert replay.replay(demos, "native").success[0]


def _follow(page, tab):
    def drawn() -> np.ndarray:
        return tab.screenshot()[:, :560].astype(int)

    def has(colour) -> bool:
        red, green, blue = np.moveaxis(drawn(), -1, 0)
        orange = (red > green * 1.3) & (green > blue * 1.2) & (red > 120)
        return np.mean(orange if colour == "orange" else (blue > red * 1.4)) > 0.002

    browser.wait_for(lambda: has("orange") and has("blue"), 240, "an orange peg, a blue socket")
    assert "shape" in tab.text()
    state = page.state
    tab.click("Reset")
    browser.wait_for(lambda: page.state is not state, 30, "Reset, clicked in the page")
    first = drawn()
    page.panel.shape.value = "1"
    browser.wait_for(
        lambda: np.mean(np.abs(drawn() - first).sum(axis=-1) > 60) > 1e-3, 60, "another peg"
    )
    values = "[...document.querySelectorAll('input')].map(input => input.value)"
    assert "1" in tab.evaluate(values)


def test_episodes_are_counted_anew_with_another_policy_or_task(page):
    from crsfd_jax.viewer import session

    page.counted, page.played, page.inserted = session._who(page), 5, 3
    step(page)
    assert "inserted 3 of 5 episodes" in page.panel.status.content
    page.panel.seed.value = "8"
    step(page)
    assert "of 5 episodes" not in page.panel.status.content
    page.age = page.live.config.mdp.horizon - 1
    step(page)
    assert page.played == 1 and page.inserted in (0, 1)
