"""What the documents name exists, their commands are commands, and their Python runs."""

import ast
import importlib
import re
import shlex
import sys
import tomllib
import types
from pathlib import Path

import jax
import numpy as np
import probe_env
import pytest

from crsfd_jax import cli, config
from crsfd_jax.config import ALGORITHMS
from crsfd_jax.report.methods import ARMS
from crsfd_jax.sweeps import cells
from crsfd_jax.sweeps.grid import METHODS
from crsfd_jax.training import program

TESTS = Path(__file__).parent
ROOT = TESTS.parent
FAULTS = ROOT / "docs" / "faults.md"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)
NAME = re.compile(r"python -m [\w.]+")
INDENTED = re.compile(r"(?:^    .*\n)+", re.M)


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of what is fenced, and of what is indented, each a block."""
    text = page.read_text()
    indented = INDENTED.findall(FENCE.sub("\n", text))
    return [*FENCE.findall(text), *(("", body) for body in indented)]


def commands(page: Path) -> list[str]:
    """Command lines in blocks and between backticks, without remarks."""
    prose = INDENTED.sub("\n", FENCE.sub("\n", page.read_text()))
    lines = [line for language, body in blocks(page) if not language for line in body.splitlines()]
    # A lone name of a program is no command to type.
    spans = (" ".join(span.split()) for span in re.findall(r"`((?:[^`\n]|\n(?!\n))+)`", prose))
    lines += [span for span in spans if not NAME.fullmatch(span)]
    programs = "python|pip|make|apt-get"
    found = [re.match(rf"\s*(?:[A-Z_]+=\S+ )*(?:{programs}) .*", line) for line in lines]
    return [match[0].partition("  #")[0].strip() for match in found if match]


COMMANDS = sorted({command for page in PAGES for command in commands(page)})


def words_of(command: str) -> list[str]:
    """Without the variables in front and a remark behind."""
    words = shlex.split(command, comments=True)
    while re.match(r"[A-Z_]+=", words[0]):
        words.pop(0)
    return words


class Parsed(Exception):
    """The command line was read to its end."""


@pytest.fixture
def only_parsed(tmp_path, monkeypatch):
    """Programs stop once their command line is read, in a folder with the files it names."""
    real = cli.parse

    def parse(*arguments, **named):
        raise Parsed(real(*arguments, **named))

    monkeypatch.setattr(cli, "parse", parse)
    monkeypatch.chdir(tmp_path)
    grid = dict(blocks(ROOT / "docs" / "adding_a_shape_or_robot.md"))["text"]
    (tmp_path / "plus.txt").write_text(grid)


def entry(module: str):
    """What cli.main is given when a module is run."""
    found = importlib.import_module(module)
    if hasattr(found, "__path__"):
        found = importlib.import_module(f"{module}.__main__")
    return getattr(found, "run", None) or found.main


OURS = [command for command in COMMANDS if words_of(command)[:2] == ["python", "-m"]]
OURS = [command for command in OURS if words_of(command)[2].startswith("crsfd_jax.")]


@pytest.mark.parametrize("command", OURS)
def test_every_documented_command_line_is_accepted(command, only_parsed):
    _, _, module, *arguments = words_of(command)
    if "--help" in arguments:
        with pytest.raises(SystemExit) as stop:
            entry(module)(arguments)
        assert stop.value.code == 0
        return
    with pytest.raises(Parsed) as parsed:
        entry(module)(arguments)
    options = parsed.value.args[0]
    if module == "crsfd_jax.sweep":
        assert (cells.EXPERIMENTS / f"{options.experiment}.py") in cells.available()


def test_a_command_line_with_an_unknown_option_or_value_would_be_noticed(only_parsed):
    for command in ("crsfd_jax.train --shap 2", "crsfd_jax.demos info --out x", "crsfd_jax.export"):
        module, *arguments = command.split()
        with pytest.raises(cli.UserError):
            entry(module)(arguments)


def test_commands_of_every_program_are_documented():
    modules = {words_of(command)[2] for command in OURS}
    programs = "train evaluate report view sweep demos export doctor"
    assert {f"crsfd_jax.{name}" for name in programs.split()} <= modules
    assert len(OURS) > 40


def test_other_documented_commands_name_what_exists():
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M)
    advice = (ROOT / "crsfd_jax" / "drawing" / "opengl.py").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for command in set(COMMANDS) - {*OURS, "python -m crsfd_jax"}:
        first, second, *rest = words_of(command)
        if first == "make":
            assert second in targets, command
            for given in rest:
                cli.parse(config.Config, shlex.split(given.removeprefix("ARGS=")))
        elif first == "pip":
            extras = re.search(r"\[([\w,]+)\]", command)
            assert second == "install" and extras, command
            assert set(extras[1].split(",")) <= set(project["optional-dependencies"]), command
        elif second == "-m":
            assert rest[0] == "pytest" and all((ROOT / file).exists() for file in rest[1:]), command
        elif first == "apt-get":
            assert second == "install" and " ".join((first, second, *rest)) in advice, command
        else:
            assert (ROOT / second).is_file(), command


def test_documents_name_files_that_exist():
    """Every path between backticks, and every link; a lone NAME.py may stand anywhere."""
    known = {path.name for path in ROOT.glob("*/**/*.*") if ".venv" not in path.parts}
    for page in PAGES:
        text = page.read_text()
        linked = re.findall(r"\]\(([^)#:]+)\)", text)
        assert not [link for link in linked if not (page.parent / link).exists()], page.name
        for named in re.findall(r"`((?:[\w.]+/)*[\w.]+\.(?:py|md|xml))`", text):
            if "NAME" in named:
                continue
            anywhere = [ROOT / named, ROOT / "crsfd_jax" / named]
            exists = any(map(Path.exists, anywhere)) if "/" in named else named in known
            assert exists, f"{page.name}: {named}"


def test_the_readme_is_short_and_lists_every_page():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 150
    assert not [page.name for page in PAGES[1:] if f"docs/{page.name}" not in text]


def test_the_methods_of_the_documents_are_those_that_there_are():
    text = (ROOT / "docs" / "method.md").read_text()
    section = text.partition("## Methods")[2].partition("\n## ")[0]
    described = set(re.findall(r"^\| `(\w+)` \|", section, re.M))
    assert {*METHODS, *ARMS} <= described | {"sacfd"} <= set(ALGORITHMS)


def test_python_in_the_documents_is_run_by_a_test():
    with_python = {page.name for page in PAGES if any(b[0] == "python" for b in blocks(page))}
    assert with_python == {"environments.md", "adding_a_method.md"}


def test_the_documented_method_learns_towards_where_demonstrations_end(monkeypatch):
    """Its file is not in the package: it is the block of the page."""
    (code,) = [b for language, b in blocks(ROOT / "docs/adding_a_method.md") if language]
    method = types.ModuleType("crsfd_jax.algorithms.documented")
    exec(compile(code, "docs/adding_a_method.md", "exec"), vars(method))
    monkeypatch.setitem(sys.modules, method.__name__, method)
    given = probe_env.preparation()
    tip = np.arange(6) / 10
    next_obs = given.demos.next_obs.at[:, 14:20].set(given.demos.terminated[:, None] * tip)
    given = given._replace(demos=given.demos.replace(next_obs=next_obs))
    options = probe_env.config(algorithm="documented", seeds=1)
    goal = method.METHOD.prepare(jax.random.key(0), given, options)
    np.testing.assert_allclose(goal, tip, atol=1e-6)
    made = program.assemble([options], lambda own: probe_env.make(), given)
    _, metrics = made.advance(made.start(made.own), made.own, 0)
    assert np.isfinite(jax.device_get(metrics["critic_loss"])).all()


def test_every_test_that_the_table_of_faults_names_exists():
    named = re.findall(r"`(test_\w+)::(test_\w+)`", FAULTS.read_text())
    assert len(named) > 40
    missing = [f"{file}::{test}" for file, test in named if test not in functions(file)]
    assert not missing


def functions(file: str) -> set[str]:
    path = TESTS / f"{file}.py"
    nodes = ast.parse(path.read_text()).body if path.exists() else []
    return {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
