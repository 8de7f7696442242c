"""A deterministic policy as a file that runs without this package.

Every format maps `obs` [N, O] float32, scaled and clipped as policy.json says, to `action`
[N, A] in [-1, 1].
"""

import io
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax.learn.networks import Params
from crsfd_jax.observation import ACTION_SIZE, OBS_SIZE
from crsfd_jax.storage import npz

Layers = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weight [inputs, outputs] and bias [outputs] of each layer; relu between them, tanh at the end."""


class Format(NamedTuple):
    """How to write a policy, and how to run what was written."""

    suffix: str
    write: Callable[[Layers], bytes]
    read: Callable[[bytes], Callable[[np.ndarray], np.ndarray]]
    """bytes -> (obs [N, O]) -> action [N, A]."""


def mean_layers(actor: Params) -> Layers:
    """The layers of one seed's actor, the last without what gives the standard deviation."""
    dense = actor["params"]
    names = [f"Dense_{i}" for i in range(len(dense))]
    layers = [(np.asarray(dense[n]["kernel"]), np.asarray(dense[n]["bias"])) for n in names]
    weight, bias = layers[-1]
    return [*layers[:-1], (weight[:, :ACTION_SIZE], bias[:ACTION_SIZE])]


def forward(xp: Any, layers: Layers, obs: Any) -> Any:
    """action [N, A] of obs [N, O], in numpy or jax.numpy."""
    *hidden, (weight, bias) = layers
    for hidden_weight, hidden_bias in hidden:
        obs = xp.maximum(obs @ hidden_weight + hidden_bias, 0.0)
    return xp.tanh(obs @ weight + bias)


def _write_npz(layers: Layers) -> bytes:
    arrays = {}
    for i, (weight, bias) in enumerate(layers):
        arrays |= {f"weight{i}": weight, f"bias{i}": bias}
    return npz.content(arrays)


def _read_npz(content: bytes) -> Callable[[np.ndarray], np.ndarray]:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        count = len(arrays.files) // 2
        layers = [(arrays[f"weight{i}"], arrays[f"bias{i}"]) for i in range(count)]
    return lambda obs: forward(np, layers, obs)


def _write_onnx(layers: Layers) -> bytes:
    from onnx import TensorProto, checker, helper, numpy_helper

    nodes, weights, last = [], [], len(layers) - 1
    for i, (weight, bias) in enumerate(layers):
        weights.append(numpy_helper.from_array(np.ascontiguousarray(weight), f"weight{i}"))
        weights.append(numpy_helper.from_array(np.ascontiguousarray(bias), f"bias{i}"))
        given = f"hidden{i - 1}" if i else "obs"
        nodes.append(helper.make_node("Gemm", [given, f"weight{i}", f"bias{i}"], [f"sum{i}"]))
        kind, name = ("Tanh", "action") if i == last else ("Relu", f"hidden{i}")
        nodes.append(helper.make_node(kind, [f"sum{i}"], [name]))
    obs = helper.make_tensor_value_info("obs", TensorProto.FLOAT, ["N", OBS_SIZE])
    action = helper.make_tensor_value_info("action", TensorProto.FLOAT, ["N", ACTION_SIZE])
    graph = helper.make_graph(nodes, "policy", [obs], [action], weights)
    # Old numbers on purpose: these operators have not changed since, and old runtimes read them.
    opset = helper.make_operatorsetid("", 13)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=8)
    checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _read_onnx(content: bytes) -> Callable[[np.ndarray], np.ndarray]:
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return lambda obs: np.asarray(session.run(["action"], {"obs": obs})[0])


def _write_stablehlo(layers: Layers) -> bytes:
    from jax import export

    (count,) = export.symbolic_shape("N")
    obs = jax.ShapeDtypeStruct((count, OBS_SIZE), jnp.float32)
    act = jax.jit(lambda obs: forward(jnp, layers, obs))
    with jax.default_matmul_precision("highest"):
        return bytes(export.export(act, platforms=("cpu", "cuda", "tpu"))(obs).serialize())


def _read_stablehlo(content: bytes) -> Callable[[np.ndarray], np.ndarray]:
    from jax import export

    exported = export.deserialize(bytearray(content))
    return lambda obs: np.asarray(exported.call(obs))


FORMATS = {
    "npz": Format(".npz", _write_npz, _read_npz),
    "onnx": Format(".onnx", _write_onnx, _read_onnx),
    "stablehlo": Format(".stablehlo", _write_stablehlo, _read_stablehlo),
}
