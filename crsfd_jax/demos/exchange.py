"""Demonstrations to and from the formats of other tools."""

from crsfd_jax.demos import builtin, dataset, layout
from crsfd_jax.errors import UserError
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.storage import files

_PREFIX = "minari:"
_OUT = {"robomimic": "demos.hdf5", "minari": "crsfd/demos-v0"}
"""Where an export goes that is given no name."""


def import_file(source: str, out: str) -> dataset.Demonstrations:
    """Reads an HDF5 file of robomimic, or minari:NAME, checks it and writes our own file.

    Raises:
      UserError: the source does not fit, or the file exists; nothing is written then.
    """
    files.reserve(out)
    try:
        demos = _read(source)
        dataset.check(demos, OBS_SIZE, ACTION_SIZE, source)
        layout.check_task(demos)
    except UserError as error:
        named = str(error) if source in str(error) else f"{source}: {error}"
        raise UserError(named) from None
    dataset.save(out, demos)
    return demos


def export_file(name: str, form: str, out: str) -> str:
    """Writes our own file, or builtin, in another format; returns where it went.

    Raises:
      UserError: the file cannot be used, or the target exists.
    """
    demos, out = builtin.load(name), out or _OUT[form]
    if form == "minari":
        from crsfd_jax.demos import minari

        minari.write(out, demos)
        return f"{_PREFIX}{out}"
    files.reserve(out)
    from crsfd_jax.demos import robomimic

    robomimic.write(out, demos)
    return out


def _read(source: str) -> dataset.Demonstrations:
    if source.startswith(_PREFIX):
        from crsfd_jax.demos import minari

        return minari.read(source.removeprefix(_PREFIX))
    from crsfd_jax.demos import robomimic

    return robomimic.read(source)
