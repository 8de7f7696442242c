"""The leaves of a state as plain numpy arrays and back, with names, types and digests."""

import hashlib
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def named_leaves(state: Any) -> dict[str, Any]:
    """Path in the state -> leaf, in the order of jax.tree.leaves."""
    return {
        jax.tree_util.keystr(path): leaf
        for path, leaf in jax.tree_util.tree_flatten_with_path(state)[0]
    }


def type_name(leaf: Any) -> str:
    """Type and shape of a leaf or of its jax.ShapeDtypeStruct, such as float32[5, 3]."""
    return f"{leaf.dtype}{list(leaf.shape)}"


def stored_type(leaf: Any) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of a leaf as a plain array; a PRNG key is stored as its words."""
    if is_key(leaf):
        leaf = jax.eval_shape(jax.random.key_data, leaf)
    return leaf.shape, np.dtype(leaf.dtype)


def stored_bytes(state: Any) -> int:
    """Size of all leaves as plain arrays, for a state or for its structure."""
    types = map(stored_type, jax.tree.leaves(state))
    return sum(math.prod(shape) * dtype.itemsize for shape, dtype in types)


def is_key(leaf: Any) -> bool:
    """Whether a leaf or its structure is a typed PRNG key."""
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def key_implementation(leaf: Any) -> str | None:
    """Name of the generator of a PRNG key; None for other arrays."""
    return str(jax.random.key_impl(leaf)) if is_key(leaf) else None


def to_numpy(leaf: Any) -> np.ndarray:
    """The plain array of a leaf."""
    return np.asarray(jax.random.key_data(leaf) if is_key(leaf) else leaf, order="C")


def from_numpy(array: np.ndarray, implementation: str | None) -> jax.Array:
    """The leaf of a plain array: a PRNG key of that generator, or an array like it."""
    # Free to move to another device, as what a program starts with is: it compiles once.
    leaf = jnp.array(array)
    return jax.random.wrap_key_data(leaf, impl=implementation) if implementation else leaf


def digest(array: np.ndarray) -> str:
    """SHA-256 of an array's bytes."""
    return hashlib.sha256(array.tobytes()).hexdigest()
