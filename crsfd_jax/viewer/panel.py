"""The controls beside the scene in the browser."""

import queue
from typing import Any, NamedTuple

from crsfd_jax.options.field_types import LARGEST_SHIFT
from crsfd_jax.viewer import potential_map
from crsfd_jax.viewer.live import Live, Task

KEYS = {
    "I": (0, 1, "+x, away from the arm"),
    "K": (0, -1, "-x"),
    "J": (1, 1, "+y"),
    "L": (1, -1, "-y"),
    "U": (2, 1, "up"),
    "O": (2, -1, "down"),
}
"""Key -> axis, direction and what it does to the goal by hand; other keys move the camera."""
COARSE, FINE = 5e-3, 5e-4
"""m, of a key alone and with shift; the clearance of the parts is 1 mm."""
_HELP = """Drag the arrows at the peg's tip, or press a key: **I** +x, away from the arm, **K** -x,
**J** +y, **L** -y, **U** up, **O** down; 5 mm each, with **shift** 0.5 mm. The arm follows at
10 Hz, at most 1 cm a step."""


class Panel(NamedTuple):
    """Handles whose values are what a person wants; `asked` holds the presses of buttons."""

    shape: Any
    shift: Any
    friction: Any
    seed: Any
    paused: Any
    speed: Any
    reset: Any
    potential: Any
    forces: Any
    by_hand: Any
    recording: Any
    """Starts and stops; its label says which comes next."""
    file: Any
    save: Any
    status: Any
    asked: "queue.SimpleQueue[tuple[str, Any]]"


def make(server: Any, live: Live, start: Task) -> Panel:
    """Adds the controls to a server, set to a task."""
    gui, options = server.gui, live.config
    asked: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
    gui.set_panel_label("crsfd_jax")
    status = gui.add_markdown("")
    with gui.add_folder("Task"):
        shapes = gui.add_dropdown("shape", live.scene.shapes, initial_value=start.shape)
        shift = gui.add_slider("shift, mm", 0.0, LARGEST_SHIFT * 1e3, 0.1, start.shift * 1e3)
        usual = options.scene.friction
        friction = gui.add_slider("friction", min(0.1, usual), max(3.0, usual), 0.05, usual)
    with gui.add_folder("Policy"):
        seeds = [str(options.seed + i) for i in range(options.seeds)]
        seed = gui.add_dropdown("seed", seeds, initial_value=seeds[0])
        paused = gui.add_checkbox("pause", False)
        speed = gui.add_slider("speed", 0.1, 4.0, 0.1, 1.0)
        reset = gui.add_button("Reset")
    with gui.add_folder("Show"):
        potential = gui.add_checkbox("potential at the mouth", True)
        gui.add_image(potential_map.legend(), label="0 — potential — 1")
        forces = gui.add_checkbox("contact forces", True)
    with gui.add_folder("Record by hand", expand_by_default=False):
        gui.add_markdown(_HELP)
        by_hand = gui.add_checkbox("drive by hand", False)
        recording = gui.add_button("Start recording")
        file = gui.add_text("file", "by_hand.npz")
        save = gui.add_button("Save")
    panel = Panel(
        *(shapes, shift, friction, seed, paused, speed, reset, potential, forces),
        *(by_hand, recording, file, save, status, asked),
    )
    _listen(gui, panel)
    return panel


def task(panel: Panel) -> Task:
    """What the controls say about the task."""
    return Task(panel.shape.value, panel.shift.value * 1e-3, panel.friction.value)


def presses(panel: Panel) -> list[tuple[str, Any]]:
    """Buttons and keys pressed since the last call, oldest first."""
    found = []
    while not panel.asked.empty():
        found.append(panel.asked.get())
    return found


def _listen(gui: Any, panel: Panel) -> None:
    for name in ("reset", "recording", "save"):
        getattr(panel, name).on_click(lambda _, name=name: panel.asked.put((name, None)))
    for key, (axis, sign, meaning) in KEYS.items():
        for modifier, length in ((None, COARSE), ("shift", FINE)):
            label = f"goal: {meaning} by {length * 1e3:g} mm"
            command = gui.add_command(label, hotkey=key, modifier=modifier)
            move = (axis, sign * length)
            command.on_trigger(lambda _, move=move: panel.asked.put(("move", move)))
