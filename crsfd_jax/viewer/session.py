"""What goes on behind the page: the arm moves step by step as the controls say."""

import dataclasses
import html
import time
from collections.abc import Callable
from typing import Any

import jax
import mujoco
import numpy as np

from crsfd_jax.demos import recordable
from crsfd_jax.env import EnvState
from crsfd_jax.physics.interface import CONTROL_DT
from crsfd_jax.viewer import drawing, hand, panel, pose
from crsfd_jax.viewer.drawing import Drawing
from crsfd_jax.viewer.live import Live, Step, Task
from crsfd_jax.viewer.panel import Panel
from crsfd_jax.viewer.tape import Tape

FRAMES = 3
"""Pictures in a control step."""
_PAUSE = 0.05
_REST = 0.8
"""s, that the end of an episode stays in view."""
Sleep = Callable[[float], None]


@dataclasses.dataclass
class Session:
    """What a page shows and does; `step` changes it."""

    live: Live
    drawing: Drawing
    panel: Panel
    key: jax.Array
    task: Task
    state: EnvState
    age: int = 0
    played: int = 0
    inserted: int = 0
    counted: tuple = ()
    """What the episodes that are counted were of."""
    was_by_hand: bool = False
    tape: Tape = dataclasses.field(default_factory=Tape)
    message: str = ""


def start(live: Live, drawn: Drawing, controls: Panel, seed: int) -> Session:
    """A session at the start of its first episode."""
    wanted, key = panel.task(controls), jax.random.key(seed)
    session = Session(live, drawn, controls, key, wanted, live.reset(wanted, key))
    _begin(session)
    return session


def step(session: Session, sleep: Sleep = time.sleep) -> None:
    """Does what was asked for, then one control step, drawn in its own time."""
    for name, value in panel.presses(session.panel):
        _ASKED[name](session, value)
    _apply_task(session)
    _apply_show(session)
    if session.panel.paused.value:
        sleep(_PAUSE)
        return
    before, action = session.state, _action(session)
    taken = session.live.advance(before, action)
    session.state, session.age = taken.state, session.age + 1
    if session.tape.is_running:
        session.tape.steps.append(hand.Taken(before, np.asarray(action)[0], taken.outcome))
    wait = CONTROL_DT / FRAMES / session.panel.speed.value
    for at in pose.between(before, taken.state, taken.setpoint, FRAMES):
        began = time.perf_counter()
        drawing.show(session.drawing, at)
        sleep(max(0.0, wait - (time.perf_counter() - began)))
    _report(session)
    _end_if_over(session, taken, sleep)


def _apply_task(session: Session) -> None:
    if session.tape.is_running:
        _hold_recording(session)
    wanted, old = panel.task(session.panel), session.task
    if wanted == old:
        return
    session.task = wanted
    session.state = session.live.change_friction(session.state, session.panel.friction.value)
    if wanted.shape != old.shape:
        drawing.show_shape(session.drawing, wanted.shape)
    if wanted != old._replace(friction=wanted.friction):
        _begin(session)
    if session.tape.forget():
        session.message = "the task changed: what was recorded before is gone"


def _apply_show(session: Session) -> None:
    controls, drawn = session.panel, session.drawing
    drawn.potential.visible = controls.potential.value
    drawing.show_forces(drawn, controls.forces.value)
    drawn.goal.visible = by_hand = controls.by_hand.value
    if by_hand and not session.was_by_hand:
        _take_up_goal(session)
    session.was_by_hand = by_hand


def _action(session: Session) -> Any:
    if session.panel.by_hand.value:
        tip = np.asarray(session.state.tip)[0]
        return hand.action_towards(session.live.config.mdp, tip, _goal(session))
    row = int(session.panel.seed.value) - session.live.config.seed
    return session.live.act(session.live.actors, row, session.state)


def _goal(session: Session) -> np.ndarray:
    """[6] where the handle in the scene is, in the nominal socket's frame."""
    turn = np.zeros(3)
    mujoco.mju_quat2Vel(turn, np.asarray(session.drawing.goal.wxyz, float), 1.0)
    return np.concatenate([session.drawing.goal.position - session.drawing.scene.nominal, turn])


def _take_up_goal(session: Session) -> None:
    """Puts the handle at the tip."""
    tip, turn = np.asarray(session.state.tip)[0].astype(float), np.zeros(4)
    angle = float(np.linalg.norm(tip[3:]))
    mujoco.mju_axisAngle2Quat(turn, tip[3:] / max(angle, 1e-9), angle)
    session.drawing.goal.position = session.drawing.scene.nominal + tip[:3]
    session.drawing.goal.wxyz = turn


def _begin(session: Session) -> None:
    session.key, key = jax.random.split(session.key)
    session.state, session.age = session.live.reset(session.task, key), 0
    session.tape.steps.clear()
    drawing.show(session.drawing, pose.still(session.state))
    _take_up_goal(session)
    _report(session)


def _end_if_over(session: Session, taken: Step, sleep: Sleep) -> None:
    is_inserted, is_broken = bool(taken.outcome.terminated[0]), not bool(taken.outcome.finite[0])
    longest = session.live.config.mdp.horizon
    if session.panel.by_hand.value:
        longest = hand.LONGEST
    if not (is_inserted or is_broken or session.age >= longest):
        return
    if session.counted != (who := _who(session)):
        session.counted, session.played, session.inserted = who, 0, 0
    session.played, session.inserted = session.played + 1, session.inserted + is_inserted
    if is_broken:
        session.tape.steps.clear()
    session.tape.cut()
    _report(session, "**inserted**" if is_inserted else "not inserted")
    sleep(_REST)
    _begin(session)


def _who(session: Session) -> tuple:
    """The task, and what moves the arm."""
    by_hand = session.panel.by_hand.value
    return session.task, by_hand or session.panel.seed.value


def _report(session: Session, ending: str = "") -> None:
    mode = (
        "by hand" if session.panel.by_hand.value else f"policy of seed {session.panel.seed.value}"
    )
    lines = [
        f"Shape {session.task.shape.partition('=')[0]}, {mode}, "
        f"{session.age * CONTROL_DT:.1f} s {ending}",
    ]
    if session.counted == _who(session):
        lines.append(f"inserted {session.inserted} of {session.played} episodes")
    if session.tape.is_running or session.tape.episodes:
        running = "recording, " if session.tape.is_running else ""
        lines.append(f"{running}{len(session.tape.episodes)} episodes recorded")
    session.panel.status.content = "<br/>".join([*lines, html.escape(session.message)])


def _on_reset(session: Session, _: Any) -> None:
    session.tape.cut()
    _begin(session)


def _on_recording(session: Session, _: Any) -> None:
    session.message = recordable.refusal(session.live.config)
    if session.message:
        return
    controls, tape = session.panel, session.tape
    tape.is_running = not tape.is_running
    controls.recording.label = "Stop recording" if tape.is_running else "Start recording"
    if not tape.is_running:
        tape.cut()
        return
    controls.paused.value = False
    _apply_task(session)
    _begin(session)


def _hold_recording(session: Session) -> None:
    """A person drives, and a replay knows of no other friction than the scene's own."""
    session.panel.by_hand.value = True
    session.panel.friction.value = session.live.config.scene.friction


def _on_save(session: Session, _: Any) -> None:
    # The episode that goes on is not whole yet: it waits for its end.
    session.message = session.tape.save(
        session.panel.file.value, session.live.config, session.task.shape, session.task.shift
    )
    _report(session)


def _on_move(session: Session, move: tuple[int, float]) -> None:
    axis, metres = move
    position = np.array(session.drawing.goal.position, float)
    position[axis] += metres
    session.drawing.goal.position = position


_ASKED = {"reset": _on_reset, "recording": _on_recording, "save": _on_save, "move": _on_move}
