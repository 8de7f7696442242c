"""What the package asks of JAX before it starts."""

import importlib
import os
from importlib import metadata

import jax
import pytest

import crsfd_jax


@pytest.fixture
def loaded(monkeypatch):
    """(jaxlib's version, environment) -> XLA's flags and the precision of matrix products."""

    def load(version, **variables):
        monkeypatch.setattr(os, "environ", variables)
        monkeypatch.setattr(metadata, "version", lambda name: version)
        importlib.reload(crsfd_jax)
        return variables.get("XLA_FLAGS", ""), variables["JAX_DEFAULT_MATMUL_PRECISION"]

    return load


def test_the_flag_is_set_only_where_jaxlib_knows_it(loaded):
    assert loaded("0.10.2")[0] == "--xla_cpu_use_fusion_emitters=false"
    assert loaded("0.11.0")[0] == ""
    assert loaded("1.0")[0] == ""


def test_matrices_are_multiplied_in_full(loaded):
    assert loaded("0.10.2")[1] == "highest"


@pytest.mark.parametrize(("held", "after"), [(None, "highest"), ("high", "high")])
def test_a_jax_that_has_already_started_is_told(loaded, held, after):
    before = jax.config.jax_default_matmul_precision
    try:
        jax.config.update("jax_default_matmul_precision", held)
        loaded("0.10.2")
        assert jax.config.jax_default_matmul_precision == after
    finally:
        jax.config.update("jax_default_matmul_precision", before)


def test_what_the_user_set_is_left_alone(loaded):
    flags = "--xla_cpu_use_fusion_emitters=true"
    given = {"XLA_FLAGS": flags, "JAX_DEFAULT_MATMUL_PRECISION": "default"}
    assert loaded("0.10.2", **given) == (flags, "default")
    assert loaded("0.10.2", XLA_FLAGS="--a=b")[0].split() == [
        "--a=b",
        "--xla_cpu_use_fusion_emitters=false",
    ]
