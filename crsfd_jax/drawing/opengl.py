"""Which OpenGL to draw with, found out before mujoco is imported."""

import functools
import os
import subprocess
import sys

from crsfd_jax.errors import UserError

_PLATFORMS = ("cgl", "glfw") if sys.platform == "darwin" else ("egl", "osmesa", "glfw")
_TRIAL = """
import mujoco, mujoco.{0}
window = mujoco.{0}.GLContext(16, 16)
window.make_current()
mujoco.MjrContext(mujoco.MjSpec().compile(), 100)
"""


@functools.cache
def platform() -> str:
    """Name of the module of mujoco that opens a window-less OpenGL here.

    Each is tried in a process of its own: PyOpenGL keeps to the first one it has loaded, and
    importing mujoco fails when MUJOCO_GL names one that is missing. When MUJOCO_GL names one, no
    other is tried.

    Raises:
      UserError: none works.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    for name in (wanted,) if wanted in _PLATFORMS else _PLATFORMS:
        tried = subprocess.run(
            [sys.executable, "-c", _TRIAL.format(name)],
            env=os.environ | {"MUJOCO_GL": name},
            capture_output=True,
        )
        if tried.returncode == 0:
            return name
    found = f"MUJOCO_GL={wanted}" if wanted in _PLATFORMS else "none that works"
    advice = "unset MUJOCO_GL or install" if wanted in _PLATFORMS else "install"
    raise UserError(
        f"OpenGL: got {found}, allowed: a working {', '.join(_PLATFORMS)}; {advice} a software "
        "renderer: apt-get install libegl1 libgl1-mesa-dri libopengl0"
    )
