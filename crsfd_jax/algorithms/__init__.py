"""The learning methods: a file each, found by its name."""

import importlib

from crsfd_jax.algorithms.method import Method


def load(name: str) -> Method:
    """The method of crsfd_jax/algorithms/NAME.py."""
    return importlib.import_module(f"crsfd_jax.algorithms.{name}").METHOD
