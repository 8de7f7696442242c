"""Optional packages: whether they are here, and the command that brings them."""

import importlib.util

from crsfd_jax.errors import UserError


def install_command(extra: str) -> str:
    """What to type for an extra of this package, in the folder of its pyproject.toml."""
    return f"pip install -e '.[{extra}]'"


def require(what: str, extra: str, *modules: str) -> None:
    """Checks that the modules behind something optional can be imported.

    Raises:
      UserError: one is missing; says how to install it.
    """
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(
            f"{what}: needs {', '.join(missing)}, which is not installed; {install_command(extra)}"
        )
