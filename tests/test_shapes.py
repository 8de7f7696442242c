"""Shapes that a user draws: what is accepted, what is refused in one line, and sound parts."""

import dataclasses
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from crsfd_jax import cli, config, env, task
from crsfd_jax.errors import UserError
from crsfd_jax.options import shapes, stored, validation
from crsfd_jax.options.run_name import run_name
from crsfd_jax.physics import native
from crsfd_jax.physics.interface import Surroundings
from crsfd_jax.scene import build, digits, kinematics

KEY = "##...\n#....\n##.##\n.#..#\n.####\n.#...\n.#...\n"
"""Seven rows of five cells: neither square nor symmetric, and nothing like a digit."""
INLINE = "key=##.../#..../##.##/.#..#/.####/.#.../.#..."


@pytest.fixture
def key(tmp_path):
    file = tmp_path / "key.txt"
    file.write_text(KEY)
    return file


def test_a_file_becomes_its_grid_in_the_options(key):
    options = cli.parse(config.Config, ["--shape", str(key)])
    assert options.shape == INLINE
    assert shapes.grid(options.shape) == tuple(KEY.split())
    assert run_name(options) == "crsfd-shapekey-shift0mm-seed0x5"
    key.write_text("###\n")
    assert stored.from_dict(config.to_dict(options)).shape == INLINE, "the file is read again"


def test_the_grid_itself_can_stand_on_the_command_line():
    assert cli.parse(config.Config, ["--shape", INLINE]).shape == INLINE
    assert shapes.read("0,bar=##,4") == ("0", "bar=##", "4")


@pytest.mark.parametrize(
    ("text", "kept"),
    [("\ufeff##\r\n#.\r\n", "##/#."), ("\n\n.#.\n###\n\n", ".#./###"), ("# \n", "#")],
)
def test_byte_order_marks_line_ends_and_blank_lines_around_a_grid_do_not_matter(
    tmp_path, text, kept
):
    file = tmp_path / "my peg.v2.txt"
    file.write_bytes(text.encode())
    assert shapes.read(str(file)) == (f"my-peg-v2={kept}",)


def test_several_shapes_are_a_list_and_all_is_every_digit():
    assert shapes.read("0,2,4") == ("0", "2", "4")
    assert shapes.read("all") == config.SHAPES
    options = cli.parse(config.Config, ["--shape", "all"])
    assert run_name(options) == "crsfd-shapeall-shift0mm-seed0x5"
    assert run_name(dataclasses.replace(options, shape="0,2")).startswith("crsfd-shape0-2-")


BAD_GRIDS = {
    "": "which has no cell",
    "\n \n": "which has no cell",
    "...\n...": "which has no cell",
    " ##\n###\n": "which has ' ' in row 1",
    "##x\n": "which has 'x' in row 1, allowed: # for a cell",
    "###\n##\n": "whose row 2 has 2 cells, allowed: 3 as in row 1",
    "#.#\n#.#\n": "which is not in one piece",
    "##.\n###\n#..\n..#": "which is not in one piece",
    "##.\n#.#\n###\n": "whose rows 1 and 2 have cells that meet in a corner only",
    "########\n": "which has 1 rows of 8 cells, allowed: at most 7",
    "#\n" * 8: "which has 8 rows of 1 cells, allowed: at most 7",
    "#" * 5000: "which has more than 4096 bytes",
}


@pytest.mark.parametrize(("text", "answer"), BAD_GRIDS.items(), ids=repr)
def test_a_bad_grid_is_answered_with_what_is_wrong_in_it(tmp_path, text, answer):
    file = tmp_path / "bad.txt"
    file.write_text(text)
    refused(str(file), answer)


def refused(text, answer):
    with pytest.raises(UserError) as error:
        cli.parse(config.Config, ["--shape", text])
    message = str(error.value)
    assert message.startswith(f"--shape: got {text!r}") and answer in message
    assert "allowed: " in message and "; " in message and "\n" not in message
    with pytest.raises(UserError):
        validation.validate(config.Config(shape=text))


def test_what_is_no_text_file_is_refused_at_once(tmp_path):
    binary, pipe = tmp_path / "binary", tmp_path / "pipe"
    binary.write_bytes(bytes(range(256)))
    os.mkfifo(pipe)
    refused(str(binary), "which is not text")
    refused(str(pipe), "which is not a file")
    refused(str(tmp_path), "which is not a file")
    refused(str(tmp_path / "absent.txt"), "which does not exist")
    refused("n" * 5000, "cannot be read")


@pytest.mark.parametrize("text", ["", "7", "2,", "0,7", "x=", "x=#?", "x=#/##", "a b=#"])
def test_a_word_that_is_no_shape_is_refused(text):
    with pytest.raises(UserError, match=r"^--shape: got "):
        cli.parse(config.Config, ["--shape", text])


def test_a_shape_is_listed_once():
    refused("2,0,2", "every shape once")


def test_a_clearance_that_leaves_no_room_for_the_contact_spheres_is_refused(key):
    line = ["--shape", str(key), "--scene.clearance"]
    cli.parse(config.Config, [*line, "3.7mm"])
    with pytest.raises(UserError, match=r"--scene.clearance: got 3.8mm, .*5.71429mm.*less 2mm"):
        cli.parse(config.Config, [*line, "3.8mm"])


def test_cells_are_squares_and_the_longer_side_has_the_footprint():
    parts = digits.solids(INLINE, 0.04, 0.0)
    low = (parts.peg_boxes[:, :3] - parts.peg_boxes[:, 3:]).min(axis=0)
    high = (parts.peg_boxes[:, :3] + parts.peg_boxes[:, 3:]).max(axis=0)
    width = 0.04 * 5 / 7 / 2
    np.testing.assert_allclose(low, [-width, -0.02, 0], atol=1e-12)
    np.testing.assert_allclose(high, [width, 0.02, digits.PEG_LENGTH], atol=1e-12)
    pitch = 0.04 / 7

    def solid(x, y):
        beside = np.abs(np.array([x, y]) - parts.peg_boxes[:, :2]) - parts.peg_boxes[:, 3:5]
        return (beside.max(axis=1) < 0).any()

    drawn = [[solid((j - 2) * pitch, (3 - i) * pitch) for j in range(5)] for i in range(7)]
    assert ["".join(".#"[int(c)] for c in row) for row in drawn] == KEY.split()


@pytest.mark.parametrize(
    ("shape", "footprint"),
    [
        *((shape, 0.04) for shape in (INLINE, "block=#", "bar=#######", "ring=###/#.#/###")),
        ("1", 0.016),
        ("plus=.#./###/.#.", 0.01),
    ],
)
def test_contact_spheres_of_any_grid_lie_in_their_solids(shape, footprint):
    parts, radius = digits.solids(shape, footprint, 1e-3), digits.CORNER_RADIUS
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    circle = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    for spheres, boxes in (
        (parts.peg_corners, parts.peg_boxes),
        (parts.socket_rims, parts.socket_boxes),
    ):
        points = (spheres[:, None] + circle).reshape(-1, 1, 3)
        outside = (np.abs(points - boxes[:, :3]) - boxes[:, 3:]).max(axis=-1).min(axis=-1)
        assert outside.max() < 1e-9
    assert len(parts.peg_corners) >= 4 and len(parts.socket_rims) >= 4


@pytest.mark.parametrize(
    ("offset", "fits"), [((0, 0), True), ((3e-3, 0), False), ((0, -3e-3), False)]
)
def test_a_drawn_peg_goes_straight_into_its_socket_and_nowhere_else(at_rest, offset, fits):
    scene = build.build(config.Scene(), (*config.SHAPES, INLINE))
    links, engine = kinematics.chain(scene), native.make(scene)
    around = Surroundings(
        shape=jnp.full(1, len(config.SHAPES), jnp.int32),
        socket_offset=jnp.asarray([offset], jnp.float32),
        friction=jnp.ones(1),
    )

    def step(state, _):
        down = kinematics.pose(links, state.qpos)[:, 2] - 0.01
        state = engine.step(state, around, jnp.zeros((1, 6)).at[:, 2].set(down))
        tip = kinematics.pose(links, state.qpos)
        return state, (env.inserted(tip, around), tip)

    start = at_rest([[0.0, 0.0, 0.02]])
    inserted, tip = jax.jit(lambda s: jax.lax.scan(step, s, length=50)[1])(start)
    assert bool(inserted.any()) is fits
    assert np.isfinite(tip).all()
    assert fits or float(tip[:, 0, 2].min()) > -0.5e-3, "sinks into the block"


def test_a_run_of_several_shapes_plays_them_all_and_no_others():
    options = config.Config(shape=f"0,3,{INLINE}", engine="native")
    world = task.make_env(options)
    known = task.shapes_known(options)
    assert known == (*config.SHAPES, INLINE)
    drawn = np.asarray(world.reset(jax.random.key(0), 300).around.shape)
    values, counts = np.unique(drawn, return_counts=True)
    assert [known[v] for v in values] == ["0", "3", INLINE]
    assert counts.min() > 70
