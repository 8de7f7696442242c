"""The command line: what is accepted, and the one line that answers everything else."""

import dataclasses
import math
import os
import re
import subprocess
import sys
import typing
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crsfd_jax import __main__ as overview
from crsfd_jax import cli, evaluate
from crsfd_jax.config import ALGORITHMS, Config, Sac, to_dict
from crsfd_jax.demos import __main__ as demos
from crsfd_jax.errors import UserError
from crsfd_jax.options.limits import Interval, check_limits
from crsfd_jax.options.names import by_full_name
from crsfd_jax.options.run_name import run_name
from crsfd_jax.options.smoke import smoke_sized
from crsfd_jax.options.validation import validate
from crsfd_jax.storage import artefacts

PROGRAM = """
import sys
from crsfd_jax import cli
from crsfd_jax.config import Config
from crsfd_jax.options.run_name import run_name

def run(argv):
    print(run_name(cli.parse(Config, argv)))
    heavy = {"jax", "mujoco", "flax"} & set(sys.modules)
    if heavy:
        raise SystemExit(f"imported {heavy}")

cli.main(run)
"""

BAD = {
    "--shape 7": "--shape: got '7', allowed: 0, 1, 2, 3, 4, all, several such as 0,2, or a",
    "--shape": "--shape: got no value",
    "--shap 2": "--shap: got an unknown option, allowed: the options in --help; did you mean --sh",
    "--sac.gama 0.9": "did you mean --sac.gamma?",
    "--gamma 0.9": "did you mean --potential.gamma or --sac.gamma?",
    "--frobnicate": "--frobnicate: got an unknown option",
    "--frobnicate=3": "--frobnicate: got an unknown option",
    "stray": "stray: got a value without an option",
    "--smoke 3": "3: got a value without an option",
    "--shift 8": "--shift: got '8', allowed: a non-negative number with the unit mm, cm or m",
    "--shift -1mm": "--shift: got '-1mm'",
    "--shift 1e9mm": "--shift: got 1e+09mm, allowed: at least 0mm and at most 20mm",
    "--shift nanmm": "--shift: got 'nanmm'",
    "--shift=": "--shift: got ''",
    "--scene.clearance 0mm": "--scene.clearance: got 0mm, allowed: above 0mm and at most 5mm",
    "--scene.footprint 20mm --scene.clearance 4mm": "--scene.clearance: got 4mm, allowed: at most",
    "--seeds 0": "--seeds: got 0, allowed: at least 1 and at most 10000",
    "--seeds -1": "--seeds: got -1",
    "--seeds 1.5": "--seeds: got '1.5', allowed: a whole number",
    "--seeds nan": "--seeds: got 'nan', allowed: a whole number",
    "--seed -1": "--seed: got -1",
    "--steps -5": "--steps: got -5, allowed: at least 1, or auto",
    "--steps 0": "--steps: got 0, allowed: at least 1, or auto",
    "--steps 2000000000": "--steps: got 2000000000, allowed: at least 1 and at most 1000000000",
    "--steps 1e5": "--steps: got '1e5', allowed: a whole number",
    "--steps 2000": "--sac.warmup-steps: got 2000, allowed: at most 1984 of the 2048 that 2000",
    "--algorithm foo": "--algorithm: got 'foo', allowed: bc, crsfd, crsfd_no_free_space,",
    "--algorithm sacdf": "did you mean sacfd?",
    "--engine foo": "--engine: got 'foo', allowed: auto, native, mjx, warp; choose one of them",
    "--sac.gamma 1": "--sac.gamma: got 1, allowed: above 0 and below 1",
    "--sac.gamma 0": "--sac.gamma: got 0",
    "--potential.gamma 1.5": "--potential.gamma: got 1.5",
    "--potential.gamma 0.99": "--potential.gamma: got 0.99, allowed: at most --sac.gamma (0.98)",
    "--sac.learning-rate -1e-3": "--sac.learning-rate: got -0.001, allowed: above 0 and at most 1",
    "--sac.learning-rate nan": "--sac.learning-rate: got nan",
    "--sac.learning-rate inf": "--sac.learning-rate: got inf",
    "--sac.learning-rate x": "--sac.learning-rate: got 'x', allowed: a number",
    "--sac.hidden": "--sac.hidden: got no number",
    "--sac.hidden 64 0": "--sac.hidden: got 0",
    "--sac.hidden a": "--sac.hidden: got ['a']",
    "--envs 0": "--envs: got 0",
    "--envs 63": "--replay.capacity: got 307200, allowed: multiples of --envs (63); use 307188",
    "--replay.capacity 32": "--replay.capacity: got 32, allowed: multiples of --envs (64); use 64",
    "--evaluation.episodes 0": "--evaluation.episodes: got 0",
}


def run_program(arguments: list[str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=30)


@pytest.mark.parametrize(("line", "answer"), BAD.items())
def test_a_bad_command_line_is_answered_with_option_value_and_advice(line, answer):
    with pytest.raises(UserError) as error:
        cli.parse(Config, line.split(" "))
    assert answer in str(error.value)
    assert "; " in str(error.value) and "\n" not in str(error.value)


def test_a_bad_command_line_ends_with_one_line_on_stderr_and_exit_code_2():
    result = run_program(["--shape", "7"])
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: --shape: got '7', allowed: 0, 1, 2, 3, 4, all,")
    assert result.stderr.count("\n") == 1


def test_a_good_command_line_is_parsed_without_importing_jax_or_mujoco():
    result = run_program(["--shape", "3", "--shift", "8mm", "--seed", "5"])
    assert (result.returncode, result.stdout) == (0, "crsfd-shape3-shift8mm-seed5x5\n"), (
        result.stderr
    )


def test_help_lists_every_option_and_ends_with_exit_code_0():
    result = run_program(["--help"])
    assert result.returncode == 0 and result.stderr == ""
    headings = re.findall(r"^│ (?:-h, )?(--[\w.-]+)", result.stdout, re.MULTILINE)
    names = by_full_name(to_dict(Config()))
    assert set(headings) == {"--help", *(f"--{name.replace('_', '-')}" for name in names)}


@pytest.mark.parametrize("line", ["train --help", "demos info", "demos --help"])
def test_what_nobody_reads_to_its_end_leaves_no_traceback(line):
    program, *arguments = line.split()
    command = [sys.executable, "-m", f"crsfd_jax.{program}", *arguments]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, timeout=60)
    os.close(writer)
    assert done.stderr == b""


def test_the_error_of_a_program_becomes_its_exit_code_and_one_line(monkeypatch, capsys):
    def stop(_):
        raise UserError("cannot\ngo on", exit_code=75)

    with pytest.raises(SystemExit) as end:
        cli.main(stop)
    assert end.value.code == 75
    assert capsys.readouterr().err == "error: cannot go on\n"


@pytest.mark.parametrize("kind", [PermissionError, NotADirectoryError])
def test_a_place_that_may_not_be_entered_is_named_in_one_line(capsys, kind):
    def look(_):
        raise kind(13, "Not for you", "/there/run")

    with pytest.raises(SystemExit) as end:
        cli.main(look)
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: /there/run: Not for you; choose another place\n"


def test_a_file_in_the_place_of_a_folder_leaves_no_traceback(tmp_path):
    (tmp_path / "file").touch()
    for line in (("train", "--out"), ("evaluate",), ("report",), ("sweep", "--out")):
        command = [sys.executable, "-m", f"crsfd_jax.{line[0]}", *line[1:], tmp_path / "file" / "x"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1, done.stderr


def test_an_error_that_nobody_hears_keeps_its_exit_code():
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "crsfd_jax.train", "--shape", "9"]
    assert subprocess.run(command, stderr=writer, timeout=60).returncode == 2
    os.close(writer)


def test_ctrl_c_before_a_run_has_begun_is_one_line_and_the_code_of_a_stop(monkeypatch, capsys):
    def stop(_):
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as end:
        cli.main(stop)
    assert end.value.code == 75
    assert capsys.readouterr().err == "stopped; the same command starts again\n"


def test_the_value_a_program_returns_is_its_exit_code():
    for returned, code in ((None, 0), (0, 0), (1, 1)):
        with pytest.raises(SystemExit) as end:
            cli.main(lambda _, returned=returned: returned)
        assert end.value.code == code


def test_defaults_are_valid_and_survive_the_command_line():
    validate(Config())
    assert cli.parse(Config, []) == Config()
    assert to_dict(Config())["sac"]["hidden"] == (128, 128)


def test_both_ends_of_an_interval_are_kept_or_left_out_as_it_says():
    for ends, low, high in (("", True, True), ("low", False, True), ("both", False, False)):
        interval = Interval(0, 1, open=ends)
        assert (interval.contains(0), interval.contains(1)) == (low, high)
        assert interval.contains(0.5) and not interval.contains(math.nan)


def test_every_number_of_the_configuration_has_a_range():
    def numbers_without_range(config_type):
        for name, hint in typing.get_type_hints(config_type, include_extras=True).items():
            base = getattr(hint, "__origin__", hint)
            if dataclasses.is_dataclass(hint):
                yield from numbers_without_range(hint)
            limits = getattr(hint, "__metadata__", ())
            is_number = base in (int, float) or typing.get_origin(base) is tuple
            if is_number and not any(isinstance(limit, Interval) for limit in limits):
                yield f"{config_type.__name__}.{name}"

    assert list(numbers_without_range(Config)) == []


def test_a_configuration_made_in_python_is_checked_like_one_from_the_command_line():
    with pytest.raises(UserError, match=r"--sac.hidden: got no number"):
        validate(Config(sac=Sac(hidden=())))
    with pytest.raises(UserError, match=r"--engine: got 'foo'"):
        check_limits(Config(engine="foo"))  # type: ignore[arg-type]


def test_a_smoke_run_is_no_larger_than_asked_for():
    line = "--smoke --evaluation.episodes 3 --evaluation.every 512 --sac.updates-per-step 1"
    small = smoke_sized(cli.parse(Config, line.split()))
    assert (small.evaluation.episodes, small.evaluation.every) == (3, 512)
    assert small.sac.updates_per_step == 1


def test_a_run_whose_every_step_is_warm_up_is_refused():
    with pytest.raises(UserError, match=r"--sac.warmup-steps: got 2000, allowed: at most 1984"):
        cli.parse(Config, ["--steps", "2048"])
    assert cli.parse(Config, ["--steps", "2049"]).steps == 2049


@pytest.mark.parametrize(
    ("line", "steps"),
    [
        ("", 40_000),
        ("--shift 8mm", 300_000),
        ("--shift 8mm --steps auto", 300_000),
        ("--shift 8mm --steps 40000", 40_000),
        ("--shift 8mm --smoke", 4096),
    ],
)
def test_a_hole_that_may_have_moved_is_given_more_steps(line, steps):
    assert cli.parse(Config, line.split()).steps == steps
    assert to_dict(cli.parse(Config, line.split()))["steps"] == steps


def test_values_fit_each_other_in_the_size_that_is_run():
    assert cli.parse(Config, ["--smoke", "--steps", "1024"]).sac.warmup_steps == 512
    with pytest.raises(UserError, match=r"--sac.warmup-steps: got 512, allowed: at most 496"):
        cli.parse(Config, ["--smoke", "--steps", "400"])
    with pytest.raises(UserError, match=r"--replay.capacity: got"):
        cli.parse(Config, ["--smoke", "--replay.capacity", "-64"])


def test_a_run_is_named_by_what_tells_it_apart():
    config = Config(shape="2", shift=0.008, algorithm="sacfd", seed=3, seeds=2)
    assert run_name(config) == "sacfd-shape2-shift8mm-seed3x2"
    assert run_name(dataclasses.replace(config, smoke=True)).endswith("-smoke")
    assert len({run_name(Config(algorithm=name)) for name in ALGORITHMS}) == len(ALGORITHMS)
    assert run_name(Config(sac=Sac(gamma=0.96))) == "crsfd-shape2-shift0mm-seed0x5-sac.gamma0.96"


def test_a_name_fits_a_file_system_however_much_is_unusual():
    names = {run_name(Config(demos="x" * 300, sac=Sac(gamma=gamma))) for gamma in (0.96, 0.97)}
    assert len(names) == 2 and max(map(len, names)) < 255


def test_a_quick_check_is_named_alike_before_and_after_it_is_shrunk():
    config = Config(smoke=True, steps=3000)
    assert run_name(config) == run_name(smoke_sized(config))
    assert run_name(config) == "crsfd-shape2-shift0mm-seed0x2-smoke"


OPTIONS = st.sampled_from(
    [
        *("--shape", "--shift", "--seeds", "--sac.hidden", "--engine", "--smoke", "--no-smoke"),
        *("--", "-h", "--replay.capacity", "--sac", "--out", "--potential.terminal=zero"),
    ]
)
VALUES = st.one_of(
    st.sampled_from(
        ["2", "8mm", "-1", "nan", "1e400", "", "64", "auto", "0.5", "é", "\udcff", "│"]
    ),
    st.text(st.characters(blacklist_characters="\0"), max_size=8),
)


ARGUMENTS = st.lists(st.one_of(OPTIONS, VALUES), max_size=6)


@settings(max_examples=60, deadline=None)
@given(ARGUMENTS)
def test_any_argument_list_gives_a_configuration_help_or_one_line(argv):
    check_arguments(argv)


def check_arguments(argv):
    try:
        validate(cli.parse(Config, argv))
    except UserError as error:
        assert error.exit_code == 2 and len(str(error)) > 10
    except SystemExit as stop:
        assert stop.code in (None, 0) and {"-h", "--help"} & set(argv)


@pytest.mark.parametrize(
    ("module", "line", "answer"),
    [
        (evaluate, "", "got too few values, missing: RUN Folder of the run."),
        (demos, "record --shift 4mm", "--shift: got an unknown option, allowed: the options in"),
        (demos, "record --nois 3", "did you mean --noise?"),
    ],
)
def test_other_programs_answer_in_the_same_words(module, line, answer):
    with pytest.raises(UserError) as refused:
        module.run(line.split())
    assert answer in str(refused.value) and "did you mean --shift" not in str(refused.value)


def test_an_evaluation_overwrites_no_file(tmp_path):
    with artefacts.open_run(tmp_path / "run", Config(), "here", []):
        pass
    run, table = str(tmp_path / "run"), tmp_path / "table.csv"
    table.touch()
    with pytest.raises(UserError, match=r"--csv: got .* which exists"):
        evaluate.task_of([run, "--csv", str(table)])


def test_the_package_lists_every_program(capsys):
    overview.run(["--help"])
    lines = capsys.readouterr().out.splitlines()
    edges = Path(overview.__file__).parent.rglob("*.py")
    programs = {p for p in edges if "    cli.main(" in p.read_text()} - {Path(overview.__file__)}
    names = {p.stem if p.stem != "__main__" else p.parent.name for p in programs}
    assert {line.split()[0] for line in lines[2:]} == names
    assert all(len(line.split()) > 3 for line in lines[2:])
    with pytest.raises(UserError, match=r"python -m crsfd_jax.train"):
        overview.run(["train", "--shape", "2"])
