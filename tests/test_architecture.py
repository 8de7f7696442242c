"""Imports run one way, files and functions stay short, and a bad command line needs no jax."""

import ast
import functools
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = "crsfd_jax"
ORDER = tuple(
    """
    errors extras types intervals silence
    storage.files storage.npz options.units options.names options.limits options.shapes
    options.field_types options.randomisation config options.stored options.smoke options.schedule
    options.validation cli options.keywords options.run_name options.together options.trials
    interrupt compile_cache progress
    storage.leaves storage.metrics training.troubles curve
    storage.run_folder storage.manifest storage.trials storage.loggers storage.policy
    storage.artefacts storage.array_store storage.checkpoints
    sweeps
    scene.digits scene.build scene.kinematics drawing
    physics.interface physics.host_call physics.native physics.mjx physics.select
    observation scene.randomize sensing env task functional training.devices
    demos.options demos.provenance demos.dataset demos.builtin
    demos.layout demos.replay demos.hdf5 demos.robomimic demos.minari demos.exchange
    learn algorithms free_space preparation training.divergence training.warmup
    training.train_step training.chunk evaluation
    storage.trained success deploy shown_potential
    demos.recordable demos.rollout demos.expert demos.record demos.commands
    report gym checkup training.program training.standing training.verdict viewer
    training.clips training.bookkeeping training.trainer
    view evaluate train sweep doctor export report.__main__ demos.__main__ __main__
    """.split()  # noqa: SIM905
)
"""Bottom first: modules, or packages as a whole. A module may import what stands before it."""


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT / PACKAGE).with_suffix("").parts
    return ".".join(parts).removesuffix("__init__").removesuffix(".")


MODULES = {name_of(path): path for path in sorted((ROOT / PACKAGE).rglob("*.py"))}
SOURCES = [
    path
    for folder in (PACKAGE, "bench", "experiments")
    for path in sorted((ROOT / folder).rglob("*.py"))
]


@functools.cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def imports(nodes) -> set[str]:
    """Full names of what import statements name."""
    names = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def known(name: str) -> str | None:
    """The module of this package that a full name lies in."""
    if not name.startswith(f"{PACKAGE}."):
        return None
    inner = name.removeprefix(f"{PACKAGE}.")
    while inner and inner not in MODULES:
        inner = inner.rpartition(".")[0]
    return inner or None


def needed(module: str, at_start: bool = False) -> set[str]:
    """Modules of this package that a module imports, anywhere or when it is imported itself."""
    nodes = tree(MODULES[module]).body if at_start else ast.walk(tree(MODULES[module]))
    return {name for name in map(known, imports(nodes)) if name} - {module}


def place(module: str) -> int | None:
    """Index in ORDER of the module or of a package around it."""
    while module:
        if module in ORDER:
            return ORDER.index(module)
        module = module.rpartition(".")[0]
    return None


def is_empty(module: str) -> bool:
    return not tree(MODULES[module]).body


@pytest.mark.parametrize("module", [m for m in MODULES if m and not is_empty(m)])
def test_a_module_imports_only_what_stands_before_it(module):
    own = place(module)
    assert own is not None, f"give {module} a place in ORDER"
    later = {name for name in needed(module) if not is_empty(name) and (place(name) or 0) > own}
    assert not later, f"{module} imports {sorted(later)}, which stand after it"


def test_every_place_in_the_order_is_taken():
    packages = {name.rpartition(".")[0] for name in MODULES}
    assert not set(ORDER) - set(MODULES) - packages
    assert len(set(ORDER)) == len(ORDER)


def test_no_module_needs_itself():
    done = set()

    def search(module, above):
        assert module not in above, f"cycle: {' -> '.join((*above, module))}"
        for name in needed(module) - done:
            search(name, (*above, module))
        done.add(module)

    for module in MODULES:
        search(module, ())


def closure(module: str, at_start: bool = False) -> set[str]:
    """A module and all of this package that it brings with it."""
    found, todo = set(), {module}
    while todo:
        found |= (now := todo)
        todo = {name for m in now for name in needed(m, at_start)} - found
    return found


@pytest.mark.parametrize(
    "module",
    [
        "",
        "cli",
        "config",
        "train",
        "evaluate",
        "view",
        "report.__main__",
        "sweep",
        "export",
        "doctor",
    ],
)
def test_a_command_line_is_read_without_jax_and_mujoco(module):
    heavy = {"jax", "mujoco", "flax", "optax", "orbax"}
    for name in closure(module, at_start=True) | {""}:
        outside = {full.partition(".")[0] for full in imports(tree(MODULES[name]).body)}
        assert not outside & heavy, f"{name} imports {sorted(outside & heavy)}"


@pytest.mark.parametrize("module", [m for m in MODULES if m.startswith("learn.")])
def test_learning_knows_nothing_of_the_simulator(module):
    simulator = {"scene", "physics", "env", "task"}
    assert not {name.partition(".")[0] for name in closure(module)} & simulator


def test_nothing_is_unpickled_or_run_from_a_file():
    for path in SOURCES:
        names = {name.partition(".")[0] for name in imports(ast.walk(tree(path)))}
        assert not names & {"pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}, path
        calls = [node for node in ast.walk(tree(path)) if isinstance(node, ast.Call)]
        assert not {call.func.id for call in calls if isinstance(call.func, ast.Name)} & {
            "eval",
            "exec",
        }, path
        allowed = [word for call in calls for word in call.keywords if word.arg == "allow_pickle"]
        assert all(ast.unparse(word.value) == "False" for word in allowed), path


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_and_functions_stay_short(path):
    assert len(path.read_text().splitlines()) <= 250
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno - node.lineno < 60, f"{node.name} is longer than 60 lines"


def names_in(module: str) -> set[str]:
    """What a module defines or imports, and the modules in a package."""
    names = {name.rpartition(".")[2] for name in MODULES if name.rpartition(".")[0] == module}
    for node in tree(MODULES[module]).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in node.names}
        else:
            names |= {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    return names


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_is_read_of_a_module_is_there(path):
    nodes = list(ast.walk(tree(path)))
    read_of = {}
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            inner = f"{node.module}.".removeprefix(f"{PACKAGE}.")
            for alias in node.names:
                if inner + alias.name in MODULES and node.module.startswith(PACKAGE):
                    read_of[alias.asname or alias.name] = inner + alias.name
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = read_of.get(node.value.id)
            assert module is None or node.attr in names_in(module), ast.unparse(node)
