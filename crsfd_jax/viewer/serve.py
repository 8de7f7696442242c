"""The viewer's page: served until it is stopped."""

import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from crsfd_jax import algorithms, compile_cache, extras, shown_potential
from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.viewer import drawing, live, panel, potential_map, session


def watch(run: str, shape: str | None, shift: float | None, host: str, port: int) -> None:
    """Serves a page on which the policies of a run act, until Ctrl-C.

    Raises:
      UserError: the run or the port cannot be used, or the extra is missing.
    """
    extras.require("the browser viewer", "view", "mjviser", "viser")
    _refuse_taken(host, port)
    compile_cache.enable()
    with opened(run, shape, shift, host, port) as page:
        print(hint(host, port), flush=True)
        try:
            while True:
                session.step(page)
        except KeyboardInterrupt:
            print()


@contextmanager
def opened(
    run: str, shape: str | None, shift: float | None, host: str, port: int
) -> Iterator[session.Session]:
    """A page that is served while the block lasts; `session.step` keeps it moving."""
    import viser

    loaded = live.load(run)
    wanted = live.task_of(loaded, shape, shift)
    picture = _potential(loaded.config)
    # Browsers open connections in advance and drop them, which is no error.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    server: Any = viser.ViserServer(host=host, port=port, label="crsfd_jax", verbose=False)
    try:
        drawn = drawing.make(server, loaded.scene, wanted.shape, picture)
        controls = panel.make(server, loaded, wanted)
        yield session.start(loaded, drawn, controls, loaded.config.seed)
    finally:
        server.stop()


def _potential(options: Config) -> np.ndarray:
    """The potential at the mouth; nothing where there is none, and a line says why."""
    try:
        if "potential" not in algorithms.load(options.algorithm).options:
            raise UserError(f"{options.algorithm} has none that sees the tip's pose alone")
        phi, _ = shown_potential.fit(options)
    except UserError as error:
        print(f"no potential is shown: {error}", flush=True)
        return potential_map.over_mouth(lambda poses: np.zeros(poses.shape[:-1]))
    return potential_map.over_mouth(phi)


def hint(host: str, port: int) -> str:
    """Where the page is, and how to see it from another machine."""
    lines = [f"open http://localhost:{port} in a browser; Ctrl-C stops"]
    if host in ("127.0.0.1", "localhost"):
        name = socket.gethostname()
        lines.append(
            f"from another machine: ssh -L {port}:localhost:{port} {name}, then the same address"
        )
    return "\n".join(lines)


def _refuse_taken(host: str, port: int) -> None:
    """Refuses a port that is in use; viser would quietly take another one.

    Raises:
      UserError: it is, or the address is none of this machine's.
    """
    try:
        with socket.create_server((host, port)):
            pass
    except OSError as error:
        raise UserError(
            f"--port: got {host}:{port}, allowed: a free one; choose another ({error.strerror})"
        ) from None
