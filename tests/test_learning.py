"""The product's claim in small: an unseen shape is learned from demonstrations of another."""

import subprocess
import sys

import pytest

from crsfd_jax.storage import metrics


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_shape_2_is_learned_from_demonstrations_of_shape_0(tmp_path):
    command = (sys.executable, "-m", "crsfd_jax.train", "--shape", "2", "--seeds", "2")
    subprocess.run([*command, "--out", str(tmp_path / "run")], check=True)
    table = metrics.read(tmp_path / "run" / "metrics.csv")
    last = table["env_steps"] == table["env_steps"].max()
    assert (table["eval/success_rate"][last] >= 0.95).all()
    first_half = table["env_steps"] <= table["env_steps"].max() / 2
    # The lowest of ten seeds has 0.61 (results/early); without shaping the highest has 0.60.
    assert table["eval/success_rate"][first_half].mean() > 0.605
