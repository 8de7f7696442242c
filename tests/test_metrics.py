"""metrics.csv: each (step, seed) exactly once, whatever happened in between."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crsfd_jax.errors import UserError
from crsfd_jax.storage import metrics


def row(env_steps, seed, success=0.5):
    return {"env_steps": env_steps, "seed": seed, "eval/success_rate": success}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "metrics.csv"


def test_rows_come_back_as_columns(path):
    metrics.append(path, [row(100, 0, 0.25), row(100, 1, float("nan"))])
    metrics.append(path, [dict(reversed(row(200, 0).items()))])
    columns = metrics.read(path)
    assert list(columns) == ["env_steps", "seed", "eval/success_rate"]
    assert columns["env_steps"].tolist() == [100, 100, 200]
    assert columns["seed"].dtype == np.int64
    np.testing.assert_array_equal(columns["eval/success_rate"], [0.25, np.nan, 0.5])


@given(st.floats(width=32, allow_nan=False))
def test_a_single_precision_number_survives_the_file(tmp_path_factory, number):
    path = tmp_path_factory.mktemp("number") / "metrics.csv"
    metrics.append(path, [row(1, 0, np.float32(number))])
    assert np.float32(metrics.read(path)["eval/success_rate"][0]) == np.float32(number)


def test_other_columns_than_the_header_are_refused_and_nothing_is_written(path):
    metrics.append(path, [row(100, 0)])
    before = path.read_bytes()
    with pytest.raises(UserError, match="columns eval/success_rate are only in"):
        metrics.append(path, [{"env_steps": 200, "seed": 0, "loss": 1.0}])
    assert path.read_bytes() == before


def test_a_column_that_is_younger_than_the_file_is_unknown_in_its_older_rows(path):
    metrics.append(path, [row(100, 0), row(100, 1)])
    metrics.append(path, [row(200, 0) | {"loss": 1.0}])
    table = metrics.read(path)
    assert table["env_steps"].tolist() == [100, 100, 200]
    np.testing.assert_array_equal(table["loss"], [np.nan, np.nan, 1.0])
    metrics.truncate(path, 100)
    metrics.append(path, [row(200, 0) | {"loss": 1.0}])
    np.testing.assert_array_equal(metrics.read(path)["loss"], [np.nan, np.nan, 1.0])


def test_no_rows_write_nothing(path):
    metrics.append(path, [])
    assert not path.exists()


def test_continuing_forgets_what_came_after_the_checkpoint(path):
    for steps in (100, 200, 300):
        metrics.append(path, [row(steps, 0), row(steps, 1)])
    uninterrupted = path.read_bytes()
    metrics.truncate(path, 200)
    assert metrics.read(path)["env_steps"].tolist() == [100, 100, 200, 200]
    metrics.append(path, [row(300, 0), row(300, 1)])
    assert path.read_bytes() == uninterrupted


def test_a_file_cut_short_anywhere_is_mended_by_continuing(path):
    rows = [row(100, 0), row(100, 1), row(200, 0), row(200, 1)]
    metrics.append(path, rows)
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        metrics.truncate(path, 100)
        kept = len(metrics.read(path)["seed"]) if path.exists() else 0
        metrics.append(path, rows[kept:])
        assert path.read_bytes() == whole


def test_a_missing_file_stays_missing_and_cannot_be_read(path):
    metrics.truncate(path, 100)
    assert not path.exists()
    with pytest.raises(UserError, match="no metrics"):
        metrics.read(path)


@pytest.mark.parametrize(
    "text", ["a,b\n1,2\n", "env_steps,seed\n1\n2,3\n", "env_steps,seed\nx,1\n"]
)
def test_a_file_that_is_no_metrics_file_is_refused_by_name(path, text):
    path.write_text(text)
    with pytest.raises(UserError, match=r"metrics.csv"):
        metrics.read(path)


def test_a_damaged_line_is_named_with_what_does_not_lose_the_run(path):
    path.write_text("env_steps,seed\n1,0\n2,x\n")
    with pytest.raises(UserError, match="line 3 is damaged; copy the file back or choose another"):
        metrics.read(path)
