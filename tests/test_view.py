"""The scene's look changes no physics, and its pictures show what they claim to show."""

import mujoco
import numpy as np
import pytest
from PIL import Image

from crsfd_jax import config, view
from crsfd_jax.drawing import opengl, picture, video
from crsfd_jax.errors import UserError
from crsfd_jax.options import shapes
from crsfd_jax.scene import build, kinematics

SCENE = build.build(config.Scene())
YELLOW = (255, 214, 64)


def _missing_opengl() -> str:
    try:
        opengl.platform()
    except UserError as error:
        return str(error)
    return ""


needs_opengl = pytest.mark.skipif(bool(_missing_opengl()), reason=_missing_opengl())


def _arm_without_decor(decor: bool) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(build.mjcf_folder() / "insertion.xml"))
    spec.body("hand").add_site(name="tip")
    if not decor:
        for geom in [g for g in spec.geoms if g.contype == 0 and g.conaffinity == 0]:
            spec.delete(geom)
    return spec.compile()


def test_the_arm_moves_the_same_without_its_shells():
    ends = []
    for decor in (True, False):
        model = _arm_without_decor(decor)
        data = mujoco.MjData(model)
        data.qpos[:] = [0.1, 0.2, 0.0, -2.5, 0.0, 2.7, 0.8]
        mujoco.mj_step(model, data, 200)
        ends.append((model.ngeom, model.body_mass.copy(), data.qpos.copy()))
    assert ends[0][0] > 50 and ends[1][0] == 0
    np.testing.assert_array_equal(ends[0][1], ends[1][1])
    np.testing.assert_allclose(ends[0][2], ends[1][2], atol=1e-9)


@needs_opengl
@pytest.mark.parametrize("shape", config.SHAPES)
def test_the_hole_reads_as_its_digit_from_above(shape):
    model = build.model_of(SCENE, SCENE.shapes.index(shape))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    image = picture.render(model, data, "hole", 400, 300).astype(int)
    camera = model.camera("hole")
    metres = 2 * camera.pos[2] * np.tan(np.radians(camera.fovy[0]) / 2) / 300
    centres = (np.arange(5) - 2) * config.Scene().footprint / 5 / metres
    columns, rows = (200 + centres).astype(int), (150 + centres).astype(int)
    dark = image[np.ix_(rows, columns)].sum(axis=-1) < 100
    assert ["".join(".#"[int(cell)] for cell in row) for row in dark] == list(shapes.GRIDS[shape])


@needs_opengl
def test_the_close_view_shows_an_orange_peg_and_a_blue_socket():
    model = build.model_of(SCENE, 0)
    data = mujoco.MjData(model)
    data.qpos[:] = kinematics.HOME
    mujoco.mj_forward(model, data)
    image = picture.render(model, data, "close", 300, 225).astype(int)
    red, green, blue = np.moveaxis(image, -1, 0)
    assert image.shape == (225, 300, 3)
    assert np.mean((red > green * 1.5) & (green > blue)) > 0.02
    assert np.mean((blue > red * 1.5) & (blue > green)) > 0.1


@needs_opengl
def test_the_marked_square_has_the_side_of_the_shift_and_the_socket_in_its_corner(tmp_path):
    target = tmp_path / "view.png"
    view.main(["--shape", "0", "--shift", "20mm", "--png", str(target)])
    image = np.asarray(Image.open(target))
    assert image.shape == (900, 1500, 3)
    socket = image[500:850, 910:].astype(int)
    rows, columns = np.nonzero((socket == YELLOW).all(axis=-1))
    hole = np.nonzero((socket.sum(axis=-1) < 100).any(axis=0))[0]
    pixels_per_metre = np.ptp(hole) / config.Scene().footprint
    assert np.ptp(columns) == pytest.approx(0.02 * pixels_per_metre, abs=4)
    assert np.ptp(rows) == pytest.approx(0.02 * pixels_per_metre, abs=4)
    assert columns.max() == pytest.approx(hole.mean(), abs=4)
    assert rows.min() + 500 == pytest.approx(675, abs=4)


@pytest.mark.parametrize(
    "line",
    [
        ["--shape", "7"],
        ["--shift", "4"],
        ["--shift", "1m"],
        ["--scene.clearance", "0mm"],
        ["--png", "scene.jpg"],
        ["--episodes", "5", "run"],
        ["--port", "8081"],
        ["--host", "0.0.0.0", "run", "--video", "out.gif"],
        ["--png", "scene.png", "run"],
        ["--scene.clearance", "2mm", "run"],
    ],
)
def test_an_unusable_option_is_named_in_one_line(line):
    with pytest.raises(UserError, match=f"^{line[0].split('.')[0]}.*: got .*allowed") as caught:
        view.main(line)
    assert caught.value.exit_code == 2 and "\n" not in str(caught.value)


@needs_opengl
@pytest.mark.parametrize("place", ["absent/view.png", "."])
def test_a_file_that_cannot_be_written_is_named_in_one_line(tmp_path, place):
    with pytest.raises(UserError, match=r"^--png: got .*allowed") as caught:
        view.main(["--png", str(tmp_path / place)])
    assert caught.value.exit_code == 2 and "\n" not in str(caught.value)


def test_a_machine_without_opengl_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(opengl, "_PLATFORMS", ("absent",))
    with pytest.raises(
        UserError, match="apt-get install libegl1 libgl1-mesa-dri libopengl0"
    ) as caught:
        opengl.platform.__wrapped__()
    assert caught.value.exit_code == 2 and "\n" not in str(caught.value)


def test_a_gif_gives_its_frames_back(tmp_path):
    frames = [np.full((8, 6, 3), shade, np.uint8) for shade in (0, 120, 255)]
    video.write(tmp_path / "run.gif", frames, 0.1)
    with Image.open(tmp_path / "run.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["duration"]) == (3, (6, 8), 100)
        for i, frame in enumerate(frames):
            gif.seek(i)
            np.testing.assert_array_equal(np.asarray(gif.convert("RGB")), frame)
    with pytest.raises(ValueError, match="got 0 frames"):
        video.write(tmp_path / "none.gif", [], 0.1)
