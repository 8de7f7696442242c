"""The readers and the command line under many more random inputs than in every test run."""

import pytest
import test_cli
import test_dataset
from hypothesis import given, settings

pytestmark = pytest.mark.faults


@settings(max_examples=700, deadline=None)
@given(test_dataset.BYTES)
def test_700_demonstration_files_with_changed_bytes_load_or_are_refused(tmp_path_factory, changes):
    test_dataset.check_changed_bytes(tmp_path_factory.mktemp("fuzz") / "demos.npz", changes)


@settings(max_examples=300, deadline=None)
@given(*test_dataset.PATCHES)
def test_300_arrays_with_changed_bytes_load_or_are_refused(tmp_path_factory, name, patch, position):
    path = tmp_path_factory.mktemp("fuzz") / "demos.npz"
    test_dataset.check_patched_array(path, name, patch, position)


@settings(max_examples=500, deadline=None)
@given(test_cli.ARGUMENTS)
def test_500_argument_lists_give_a_configuration_help_or_one_line(argv):
    test_cli.check_arguments(argv)
