"""Writing .npz files, and reading those of unknown origin: bounded memory, no pickles."""

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from crsfd_jax.errors import UserError
from crsfd_jax.storage.files import write_atomically

_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    tokenize.TokenError,
    SyntaxError,
    ValueError,
    EOFError,
    RuntimeError,
    LookupError,
    OverflowError,
    MemoryError,
    TypeError,
)
"""What zipfile and numpy's header parser raise on bytes that were never an .npz file."""


def write(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Replaces a file by one of named arrays, as `write_atomically` does."""
    write_atomically(path, lambda stream: stream.write(content(arrays)))


def content(arrays: Mapping[str, np.ndarray]) -> bytes:
    """The bytes of a file of named arrays."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]
    return stream.getvalue()


def read(path: Path, dtypes: Mapping[str, type], max_bytes: int) -> dict[str, np.ndarray]:
    """Reads exactly the named arrays.

    Args:
      dtypes: name -> scalar type; np.str_ stands for a string of any length.
      max_bytes: limit of all arrays together, checked before anything is allocated.

    Raises:
      UserError: the file is missing, a link, damaged, too large, or has other arrays.
    """
    if path.is_symlink():
        raise UserError(f"{path}: is a link; give the file itself, {path.readlink()}")
    if path.exists() and not path.is_file() and not path.is_dir():
        raise UserError(f"{path}: is a device or a pipe, expected a file; check the name")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_members(archive, dtypes, max_bytes)
            return {name: _read_array(archive, name, dtypes[name]) for name in dtypes}
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    except OSError as error:
        reason = error.strerror or "it is damaged"
        raise UserError(f"{path}: cannot be read: {reason}; check the name") from error
    except _DAMAGE as error:
        raise UserError(
            f"{path}: not a readable .npz file, cut short or damaged "
            f"({type(error).__name__}); record or copy it again"
        ) from error


def _check_members(archive: zipfile.ZipFile, dtypes: Mapping[str, type], max_bytes: int) -> None:
    members = archive.infolist()
    found, expected = sorted(m.filename for m in members), sorted(f"{n}.npy" for n in dtypes)
    if found != expected:
        missing = [name for name in expected if name not in found]
        extra = [name for name in found if name not in expected]
        raise UserError(
            f"arrays missing: {', '.join(missing) or 'none'}, "
            f"unknown or twice: {', '.join(extra) or 'none'}; expected {', '.join(dtypes)}"
        )
    declared = sum(member.file_size for member in members)
    if declared > max_bytes:
        raise UserError(f"declares {declared} bytes, allowed: at most {max_bytes}")


def _read_array(archive: zipfile.ZipFile, name: str, scalar: type) -> np.ndarray:
    # zipfile never hands out more than the declared size, which is bounded above.
    content = archive.read(f"{name}.npy")
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, fortran_order, dtype = read_header(stream)
    if dtype.hasobject:
        raise UserError(f"{name} contains Python objects; refused")
    if not (dtype.kind == "U" if scalar is np.str_ else dtype == np.dtype(scalar)):
        raise UserError(f"{name} is {dtype}, expected {np.dtype(scalar)}")
    if fortran_order:
        raise UserError(f"{name} is in Fortran order, expected C order")
    data = memoryview(content)[stream.tell() :]
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data):
        raise UserError(f"{name} declares shape {shape}, but holds {len(data)} bytes")
    if dtype == np.bool_ and max(data, default=0) > 1:
        raise UserError(f"{name} holds bytes that are neither true nor false")
    return np.frombuffer(data, dtype).reshape(shape).copy()
