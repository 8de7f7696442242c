"""What the documents name exists."""

import ast
import re
from pathlib import Path

TESTS = Path(__file__).parent
FAULTS = TESTS.parent / "docs" / "faults.md"


def test_every_test_that_the_table_of_faults_names_exists():
    named = re.findall(r"`(test_\w+)::(test_\w+)`", FAULTS.read_text())
    assert len(named) > 40
    missing = [f"{file}::{test}" for file, test in named if test not in functions(file)]
    assert not missing


def functions(file: str) -> set[str]:
    path = TESTS / f"{file}.py"
    nodes = ast.parse(path.read_text()).body if path.exists() else []
    return {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
