"""The controls beside the scene in the browser."""

import queue
from typing import Any, NamedTuple

from crsfd_jax.viewer import potential_map
from crsfd_jax.viewer.live import Live, Task

LARGEST_SHIFT = 20.0
KEYS = {
    "arrowup": (0, 1, "+x, away from the arm"),
    "arrowdown": (0, -1, "-x"),
    "arrowleft": (1, 1, "+y"),
    "arrowright": (1, -1, "-y"),
    "pageup": (2, 1, "up"),
    "pagedown": (2, -1, "down"),
}
"""Key -> axis, direction and what it does to the goal of a person's hand."""
_HELP = """Drag the arrows at the peg's tip, or press a key (5 mm each): arrow keys in the plane,
**page up** and **page down** vertically. The arm follows at 10 Hz, at most 1 cm a step."""


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
        shift = gui.add_slider("shift, mm", 0.0, LARGEST_SHIFT, 0.1, start.shift * 1e3)
        friction = gui.add_slider("friction", 0.1, 3.0, 0.05, start.friction)
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
        command = gui.add_command(f"goal: {meaning}", hotkey=key)
        command.on_trigger(lambda _, move=(axis, sign): panel.asked.put(("move", move)))
