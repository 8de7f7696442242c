"""Every command of the documents is run here, made small, or named with the reason why not."""

import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest
from test_docs import COMMANDS, ROOT, blocks, words_of

from crsfd_jax import sweep
from crsfd_jax.demos import builtin
from crsfd_jax.sweeps import cells

SMALL = "--smoke --steps 2048"
SMOKE = f"{SMALL} --potential.steps 20"
EXPERT = "--enough 0.3 --episodes 10"
TRAIN, DEMOS = "python -m crsfd_jax.train", "python -m crsfd_jax.demos"
EVALUATE, SWEEP = "python -m crsfd_jax.evaluate", "python -m crsfd_jax.sweep --experiment"
RECORDED = {
    f"{DEMOS} record": "demos.npz",
    f"{DEMOS} record --out mine.npz": "mine.npz",
    f"{DEMOS} record --shape 1 --episodes 20 --noise 1.5 --out one.npz": "one.npz",
    f"{DEMOS} record --shape plus.txt --out plus.npz": "plus.npz",
}
"""Command -> its file. The shipped demonstrations, of an expert that has trained to the end, take
the file's place afterwards."""
IN_ORDER = {
    f"{TRAIN} --shape 2 --shift 8mm": f"{SMOKE} --out runs/NAME",
    f"{TRAIN} --shape all --algorithm sacfd": SMALL,
    f"{TRAIN} --algorithm crsfd --shape 2": SMOKE,
    f"{TRAIN} --algorithm sqil --shape 2 --smoke": SMALL,
    f"{TRAIN} --shape plus.txt": SMOKE,
    f"{TRAIN} --shape plus.txt --shift 4mm": SMOKE,
    f"{TRAIN} --shape 0,plus.txt --steps 300000": SMOKE,
    f"{TRAIN} --shape 2 --randomisation.friction 1 2 --randomisation.delay 0.5": SMOKE,
    f"{TRAIN} --shape 2 --shift 2mm --randomisation.friction 1 2 --randomisation.delay 0.5": SMOKE,
    f"{TRAIN} --shape 2 --clips": f"{SMOKE} --out runs/filmed",
    f"XLA_FLAGS=--xla_force_host_platform_device_count=4 {TRAIN} --shape 2 --seeds 4": (
        f"{SMOKE} --out runs/devices"
    ),
    f"{EVALUATE} runs/NAME --shape 3 --shift 4mm": "--episodes 4",
    f"{EVALUATE} runs/NAME --shape plus.txt": "--episodes 4",
    f"{EVALUATE} runs/NAME --held-out": "--episodes 4",
    f"{EVALUATE} runs/NAME --held-out --episodes 100": "--episodes 4",
    f"{EVALUATE} runs/NAME --held-out --episodes 100 --randomisation.encoder-offset -0.0014 -0.001 "
    "0.001 0.0014": "--episodes 4",
    "python -m crsfd_jax.export runs/NAME --format npz --check": "",
    "python -m crsfd_jax.export runs/NAME --format onnx --check": "",
    "python experiments/real_arm/simulated_arm.py runs/NAME/export/npz 500": "4",
    "python experiments/studies/reach.py runs/NAME": "runs/NAME",
    "python experiments/studies/engines.py experiments/results/early "
    "experiments/results/setting1_warp": "",
    "python experiments/studies/warmup.py": "--shapes 2 --steps 128 --seeds 2",
    "python -m crsfd_jax.view --shape 2 --png scene.png": "",
    "python -m crsfd_jax.view --shape 2 --shift 8mm --png scene.png": "",
    "python -m crsfd_jax.view --shape plus.txt --png plus.png": "",
    "python -m crsfd_jax.view runs/NAME --video out.gif": "--episodes 1",
    f"{DEMOS} info": "",
    f"{DEMOS} check": "",
    **dict.fromkeys(RECORDED, EXPERT),
    f"{DEMOS} check mine.npz": "",
    f"{TRAIN} --shape 2 --demos mine.npz": f"{SMOKE} --out runs/mine",
    f"{TRAIN} --shape 2 --demos mine.npz --demo-episodes 10": f"{SMOKE} --out runs/mine-10",
    f"{TRAIN} --shape 1 --demos plus.npz": f"{SMOKE} --out runs/plus-1",
    f"{DEMOS} export builtin --format robomimic --out demos.hdf5": "",
    f"{DEMOS} import demos.hdf5 --out imported.npz": "",
    f"{DEMOS} check imported.npz": "",
    f"{DEMOS} export mine.npz --format minari --out crsfd/mine-v0": "",
    f"{DEMOS} import minari:crsfd/mine-v0 --out imported.npz": "",
    "python -m crsfd_jax.doctor": "--engines native --seconds 0.2",
    "python -m crsfd_jax.doctor --engines native mjx": "--seconds 0.2",
    "python -m crsfd_jax.report runs": "",
    "python -m crsfd_jax.report experiments/results --out docs/results": "",
    "python -m crsfd_jax.report experiments/results_scale1 --out runs/scale1": "",
    "python -m crsfd_jax.report experiments/results_newest_actor --out runs/newest": "",
    "python -m crsfd_jax": "",
    "make train": f"ARGS='{SMOKE} --out {{folder}}/runs/made'",
    'make train ARGS="--shape 2 --shift 8mm"': (
        f"ARGS='--shape 2 --shift 8mm {SMOKE} --out {{folder}}/runs/made-8mm'"
    ),
}
"""Commands in an order in which each finds its files, and what makes them small."""
SWEEPS = (
    f"{SWEEP} setting1 --dry-run",
    f"{SWEEP} early --dry-run",
    f"{SWEEP} setting1 --together 4 --dry-run",
    f"{SWEEP} setting1 --only 'crsfd-shape2*'",
    f"{SWEEP} setting1 --status",
    f"{SWEEP} setting1 --workers 2",
    f"{SWEEP} early",
    f"{SWEEP} setting1 -- --sac.reward-scale 1",
    f"{SWEEP} setting1 -- --sac.reward-scale 1 --sac.actor-tau 1",
    "python -m crsfd_jax.report runs/setting1",
)
"""Run on experiments of the same names whose cells are small."""
RAY = f"{SWEEP} setting1 --runner ray --workers 8 --gpus 0.25"
TOGETHER = tuple(
    f"JAX_COORDINATOR_ADDRESS=host0:4000 JAX_NUM_PROCESSES=2 JAX_PROCESS_ID={i} {TRAIN} --shape 2 "
    "--seeds 8"
    for i in range(2)
)
PAGES = ("python -m crsfd_jax.view runs/NAME", "python -m crsfd_jax.view runs/NAME --shape 0")
INSTALLS = tuple(f"pip install -c constraints.txt -e '.[{extra}]'" for extra in ("gym", "view"))
TRAINED = "needs a policy that inserts; test_recording.py has one"
NOT_RUN = {
    "make test": "is what runs this",
    "make slow": "is what runs this",
    "make extras": "installs packages into the environment that runs this",
    "make faults": "is what runs this, for the tests of faults",
    "make bench": "measures for minutes",
    "python -m pytest tests/test_scene.py tests/test_kinematics.py tests/test_engines.py "
    "tests/test_env.py": "is a part of the suite",
    "pip install -e '.[cuda,warp]'": "gigabytes, for NVIDIA GPUs",
    "pip install -e '.[cuda]'": "gigabytes, for NVIDIA GPUs",
    f"{SWEEP} transfer --only 'crsfd-shape2-shift2mm-randomised-*'": "a whole run",
    f"{TRAIN} --shape 1 --shift 4mm --and --shape 3 --shift 8mm": "two runs; test_sweep has a pair",
    f"{DEMOS} from-run runs/NAME --out next.npz": TRAINED,
    f"{DEMOS} from-run runs/NAME --out near.npz --shift 4mm --noise 1.5 --seed 2": TRAINED,
    f"{TRAIN} --shape 2 --engine warp --envs 1024 --sac.updates-per-step 256": "needs a GPU",
    "python bench/env.py --engines mjx warp --batch-sizes 320 4096": "needs a GPU",
    f"{SWEEP} setting1 --runner slurm --workers 16 --gpus 1 --slurm.partition gpu "
    "--slurm.minutes 240 --slurm.cores 8": "needs a SLURM cluster; test_sweep.py has a stand-in",
    "python experiments/studies/search.py search.png runs/NAME": "needs a run with a shift",
    "apt-get install libegl1 libgl1-mesa-dri libopengl0": "changes the machine",
}
WRITTEN = """
    runs/NAME/metrics.csv runs/NAME/policy.npz runs/NAME/curves.png runs/filmed/clips/2048.gif
    runs/NAME/export/npz/actor.npz runs/NAME/export/npz/policy.json runs/made/policy.npz
    runs/report/report.html docs/results/report.html scene.png plus.png out.gif imported.npz
"""


def test_every_documented_command_is_run_or_named_with_a_reason():
    groups = (IN_ORDER, SWEEPS, (RAY,), TOGETHER, PAGES, INSTALLS, NOT_RUN)
    known = [command for group in groups for command in group]
    not_run, not_documented = set(COMMANDS) - set(known), set(known) - set(COMMANDS)
    assert (not_run, not_documented) == (set(), set())
    assert len(known) == len(set(known))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where the commands are typed: results and programs of the repository, and a shape's file."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    grid = dict(blocks(ROOT / "docs" / "adding_a_shape_or_robot.md"))["text"]
    (tmp_path / "plus.txt").write_text(grid)
    return tmp_path


def small(command: str, more: str) -> tuple[list[str], dict[str, str]]:
    """The words of a small form of a command, and its environment."""
    set_first = dict(w.split("=", 1) for w in shlex.split(command) if w.partition("=")[0].isupper())
    given, (program, *words) = shlex.split(more), words_of(command)
    if program == "make":
        return ["make", "-C", str(ROOT), words[0], *given], os.environ | set_first
    if words[0] != "-m":
        words.pop()
    return [sys.executable, *words, *given], os.environ | set_first


def finished(command: str, more: str) -> None:
    line, environment = small(command, more)
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_documented_commands_run_one_after_the_other(folder):
    for command, more in IN_ORDER.items():
        if "imported.npz" in command and " import " in command:
            (folder / "imported.npz").unlink(missing_ok=True)
        if command in RECORDED:
            (folder / RECORDED[command]).unlink(missing_ok=True)
        finished(command, more.format(folder=folder))
        if command in RECORDED:
            shutil.copy(builtin.PATH, RECORDED[command])
    assert not [name for name in WRITTEN.split() if not (folder / name).is_file()]


@pytest.fixture
def small_experiments(folder, monkeypatch):
    """Experiments of the documented names with one or two small runs."""
    place = folder / "small"
    place.mkdir()
    for name in ("setting1", "early"):
        lines = [("--shape", shape, *SMOKE.split()) for shape in ("2", "3")]
        (place / f"{name}.py").write_text(f"CELLS = {tuple(lines)}\n")
    monkeypatch.setattr(cells, "EXPERIMENTS", place)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_documented_sweeps_run(small_experiments, folder):
    for command in SWEEPS:
        _, _, module, *words = words_of(command)
        if module == "crsfd_jax.sweep":
            assert sweep.run(words) == 0, command
        else:
            finished(command, "")
    assert len(list(folder.glob("runs/*/*/policy.npz"))) == 6


@pytest.mark.slow
def test_the_documented_sweep_on_ray_runs(small_experiments):
    pytest.importorskip("ray")
    words = words_of(RAY)[3:]
    # This machine may have no GPU; Ray would wait for one for ever.
    words[words.index("--gpus") + 1] = "0"
    assert sweep.run(words) == 0


@pytest.mark.slow
def test_the_documented_processes_of_one_run_go_together(folder):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    running = []
    for command in TOGETHER:
        here = command.replace("host0:4000", f"127.0.0.1:{port}")
        line, environment = small(here, f"{SMOKE} --out runs/together")
        pipe = subprocess.PIPE
        running.append(
            subprocess.Popen(
                line, env=environment, stdout=pipe, stderr=subprocess.STDOUT, text=True
            )
        )
    said = [process.communicate(timeout=500)[0] for process in running]
    assert [process.returncode for process in running] == [0, 0], said
    assert (folder / "runs" / "together" / "policy.npz").is_file()


@pytest.mark.slow
def test_the_documented_viewers_serve_a_page(folder):
    pytest.importorskip("mjviser")
    finished(f"{TRAIN} --shape 2", f"{SMOKE} --out runs/NAME")
    for command in PAGES:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
        line, environment = small(command, f"--port {port}")
        with subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, text=True) as viewer:
            assert viewer.stdout is not None
            next(said for said in viewer.stdout if said.startswith("open http"))
            with urllib.request.urlopen(f"http://127.0.0.1:{port}") as reply:
                assert b"<html" in reply.read()
            viewer.send_signal(signal.SIGINT)
            viewer.communicate()
        assert viewer.returncode == 0, command


@pytest.mark.slow
@pytest.mark.parametrize("command", INSTALLS)
def test_documented_extras_can_be_installed(command):
    """Nothing is changed: pip finds versions that fit those which are there."""
    _, *words = words_of(command)
    line = [sys.executable, "-m", "pip", *words, "--dry-run", "--quiet"]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
