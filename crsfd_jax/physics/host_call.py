"""Calls numpy functions from compiled CPU programs that the compilation cache can keep.

A program with a `jax.pure_callback` holds the address of a Python object, so every process has to
compile it anew. Here the program holds a name, which each process binds to its function before the
program runs, as a handler of XLA's foreign function interface (xla/ffi/api/c_api.h in jaxlib).
"""

import atexit
import contextlib
import ctypes
import functools
import math
import re
import signal
import traceback
import warnings
from collections.abc import Callable, Sequence
from ctypes import CFUNCTYPE, POINTER, Structure
from pathlib import Path

import jax
import numpy as np

Function = Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], None]
"""(inputs, outputs): writes every element of the outputs, which hold anything before.

Both are views of the program's memory, valid during the call; inputs are read-only. Leading axes
that a vmap adds are the same for all of them. Several threads may call at the same time.
"""

_VERSION = (0, 3)
"""The interface that the structures below describe."""
_HEAD = (("struct_size", ctypes.c_size_t), ("extension", ctypes.c_void_p))


class _Extension(Structure):
    _fields_ = (("struct_size", ctypes.c_size_t), ("type", ctypes.c_int), ("next", ctypes.c_void_p))


class _Version(Structure):
    _fields_ = (*_HEAD, ("major", ctypes.c_int), ("minor", ctypes.c_int))


class _Metadata(Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("version", _Version),
        ("traits", ctypes.c_uint32),
        ("state_type", ctypes.c_int64),
    )


class _Query(Structure):
    """The extension by which XLA asks a handler what it was written for."""

    _fields_ = (("base", _Extension), ("metadata", POINTER(_Metadata)))


class _Error(Structure):
    _fields_ = (*_HEAD, ("message", ctypes.c_char_p), ("code", ctypes.c_int))


class _Api(Structure):
    """The functions that XLA offers, up to the one that is used."""

    _fields_ = (
        *_HEAD,
        ("version", _Version),
        ("internal", ctypes.c_void_p),
        ("create_error", CFUNCTYPE(ctypes.c_void_p, POINTER(_Error))),
    )


class _Buffer(Structure):
    _fields_ = (
        *_HEAD,
        ("dtype", ctypes.c_int),
        ("data", ctypes.c_void_p),
        ("rank", ctypes.c_int64),
        ("dims", POINTER(ctypes.c_int64)),
    )


class _Buffers(Structure):
    _fields_ = (
        *_HEAD,
        ("size", ctypes.c_int64),
        ("types", ctypes.c_void_p),
        ("items", POINTER(POINTER(_Buffer))),
    )


class _Frame(Structure):
    """A call, up to its results."""

    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("query", POINTER(_Query)),
        ("api", POINTER(_Api)),
        ("context", ctypes.c_void_p),
        ("stage", ctypes.c_int),
        ("inputs", _Buffers),
        ("outputs", _Buffers),
    )


_Handler = CFUNCTYPE(ctypes.c_void_p, POINTER(_Frame))
_QUERY_METADATA = 1
_INTERNAL_ERROR = 13
_DTYPES = {1: np.dtype("bool"), 4: np.dtype("int32"), 11: np.dtype("float32")}
"""Those that are passed, of the numbers that XLA knows them by."""
_HANDLERS: dict[str, object] = {}


def call(
    name: str, function: Function, results: Sequence[jax.ShapeDtypeStruct], *args: jax.Array
) -> Sequence[jax.Array]:
    """The function's outputs, shaped like `results`; what it raises, the program raises.

    Args:
      name: tells the function and all that it closes over from others: the first function of a
        name is kept. Programs come from the cache where the name is the same in every process.

    Raises:
      ValueError: another dtype than bool, int32 and float32.
    """
    for array in (*args, *results):
        if array.dtype not in _DTYPES.values():
            allowed = ", ".join(map(str, _DTYPES.values()))
            raise ValueError(f"host call {name}: got dtype {array.dtype}, allowed: {allowed}")
    if jax.default_backend() != "cpu" or not _speaks_our_version():
        return _call_back(function, results, *args)
    if not _HANDLERS:
        atexit.register(_wait_for_programs)
    if name not in _HANDLERS:
        _HANDLERS[name] = _handler(function)
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(_HANDLERS[name]), platform="cpu")
    return jax.ffi.ffi_call(name, tuple(results), vmap_method="broadcast_all")(*args)


def _call_back(function, results, *args):
    rank = args[0].ndim

    def allocate_and_call(*inputs):
        inputs = [np.asarray(array) for array in inputs]
        lead = inputs[0].shape[: inputs[0].ndim - rank]
        outputs = [np.empty(lead + result.shape, result.dtype) for result in results]
        function(inputs, outputs)
        return tuple(outputs)

    return jax.pure_callback(allocate_and_call, tuple(results), *args, vmap_method="broadcast_all")


@functools.cache
def _speaks_our_version() -> bool:
    # XLA gives up the whole backend over a handler of a version that it does not support.
    header = Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h")
    text = header.read_text() if header.is_file() else ""
    found = tuple(
        int(number) for number in re.findall(r"^#define XLA_FFI_API_M(?:AJ|IN)OR (\d+)", text, re.M)
    )
    if found != _VERSION:
        warnings.warn(
            f"jaxlib has XLA FFI version {found}, host calls are written for {_VERSION}: "
            "every start will compile anew; install the jaxlib that this package asks for",
            stacklevel=2,
        )
    return found == _VERSION


def _wait_for_programs():
    """Lets programs end before the interpreter does: a handler that it stops never returns."""
    # From here on, a second Ctrl-C must end the process, not the waiting.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Programs that one thread starts on one device run in turn, also those whose results are gone.
    last = [jax.device_put(0.0, device) + 1.0 for device in jax.local_devices(backend="cpu")]
    for array in (*last, *jax.live_arrays("cpu")):
        with contextlib.suppress(RuntimeError):
            array.block_until_ready()


def _handler(function):
    def handle(pointer):
        frame = pointer.contents
        try:
            if frame.query:
                _answer(frame.query.contents)
            else:
                function(*_arrays(frame))
        # Whatever got past this would be printed and forgotten, and the program would go on.
        except BaseException:
            return _error(frame.api.contents)
        return None

    return _Handler(handle)


def _answer(query):
    if query.base.type != _QUERY_METADATA:
        raise ValueError(f"XLA FFI extension {query.base.type}: only {_QUERY_METADATA} is known")
    metadata = query.metadata.contents
    metadata.version.struct_size = ctypes.sizeof(_Version)
    metadata.version.major, metadata.version.minor = _VERSION
    metadata.traits = metadata.state_type = 0


def _arrays(frame):
    for group in (frame.inputs, frame.outputs):
        if group.struct_size != ctypes.sizeof(_Buffers):
            raise ValueError(f"XLA FFI: a buffer list has {group.struct_size} bytes")
    inputs = [_array(frame.inputs.items[i].contents) for i in range(frame.inputs.size)]
    for array in inputs:
        array.flags.writeable = False
    return inputs, [_array(frame.outputs.items[i].contents) for i in range(frame.outputs.size)]


def _array(buffer):
    shape, dtype = buffer.dims[: buffer.rank], _DTYPES[buffer.dtype]
    size = math.prod(shape) * dtype.itemsize
    memory = (ctypes.c_char * size).from_address(buffer.data or 0)
    return np.ndarray(shape, dtype, memoryview(memory))


def _error(api):
    message = traceback.format_exc().encode(errors="replace")
    arguments = _Error(ctypes.sizeof(_Error), None, message, _INTERNAL_ERROR)
    return api.create_error(ctypes.byref(arguments))
