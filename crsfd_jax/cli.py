"""The edge of every program: the command line in, one line of error and an exit code out.

Exit codes: 0 done, 1 target missed, 2 wrong usage or input, 75 stopped but resumable.
Imports neither jax nor mujoco, so that a bad command line is answered at once.
"""

import contextlib
import io
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import tyro

from crsfd_jax.config import Config
from crsfd_jax.errors import STOPPED, USAGE, UserError
from crsfd_jax.options.limits import check_limits, choice_message
from crsfd_jax.options.smoke import smoke_sized
from crsfd_jax.options.validation import validate
from crsfd_jax.silence import silence

ConfigT = TypeVar("ConfigT")


def parse(
    config_type: type[ConfigT], argv: Sequence[str], default: ConfigT | None = None
) -> ConfigT:
    """Reads and checks a command line; --help prints the options and exits with 0.

    Args:
      default: holds the values of options that are not given; those of the type if left out.

    Raises:
      UserError: the line cannot be used; the message says which option and why.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            start = tyro.MISSING_NONPROP if default is None else default
            config = tyro.cli(config_type, args=list(argv), prog=_program_name(), default=start)
    except BrokenPipeError:
        # Of --help: it has been read as far as anybody wanted.
        silence(sys.stdout)
        sys.exit(0)
    except SystemExit as stop:
        if stop.code in (None, 0):
            raise
        raise UserError(_condense(complaint.getvalue())) from None
    check_limits(config)
    if isinstance(config, Config):
        config = smoke_sized(config) if config.smoke else config
        validate(config)
    return config


def main(function: Callable[[list[str]], int | None]) -> None:
    """Runs a program on the command line and ends the process with its exit code.

    Args:
      function: takes the arguments after the program's name, returns the exit code, or
        None for 0. A UserError from it becomes one line on stderr, and so does a place that may
        not be entered.
    """
    try:
        code = function(sys.argv[1:])
        sys.stdout.flush()
    except UserError as error:
        _complain(f"error: {' '.join(str(error).split())}")
        code = error.exit_code
    except (PermissionError, NotADirectoryError) as error:
        if error.filename is None:
            raise
        _complain(f"error: {error.filename}: {error.strerror}; choose another place")
        code = USAGE
    except KeyboardInterrupt:
        _complain("stopped; the same command starts again")
        code = STOPPED
    except BrokenPipeError:
        silence(sys.stdout)
        code = STOPPED
    sys.exit(code or 0)


def _complain(line: str) -> None:
    """Says what went wrong, if there is still somebody to tell."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        silence(sys.stderr)


def _program_name() -> str | None:
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    return f"python -m {spec.name.removesuffix('.__main__')}" if spec else None


def _condense(complaint: str) -> str:
    """Turns tyro's box of several lines into one line in this program's words."""
    lines = [line.strip("│╭╮╰╯ ") for line in complaint.splitlines()]
    title = lines[0].strip("─ ") if lines else "the command line cannot be read"
    rule = next((i for i, line in enumerate(lines) if i and not line.strip("─")), len(lines))
    body = " ".join(lines[1:rule])
    for pattern, rewrite in _REWRITES:
        match = re.search(pattern, body)
        if match:
            return rewrite(match, lines[rule:])
    return f"{title}: {body}; see --help"


def _missing_value(match: re.Match[str], _: Any) -> str:
    return f"{match[1]}: got no value, allowed: one value; write it after the option"


def _missing_values(match: re.Match[str], _: Any) -> str:
    return f"got too few values, missing: {match[1].replace(' (required)', ',').strip(' ,')}"


def _unknown_option(match: re.Match[str], advice: list[str]) -> str:
    tokens = re.sub(r" \(applied to [^)]*\)", ",", match[1]).strip(",").split(", ")
    token = next((t for t in tokens if t.startswith("-")), tokens[0]).partition("=")[0]
    what = "an unknown option" if token.startswith("-") else "a value without an option"
    headings = (re.match(r"(--[\w.-]+)(?:,| [A-Z{\[])", line) for line in advice)
    named = dict.fromkeys(heading[1] for heading in headings if heading)
    near = [name for name in named if name != token][:3]
    what_to_do = f"did you mean {' or '.join(near)}?" if near else "see --help"
    return f"{token}: got {what}, allowed: the options in --help; {what_to_do}"


def _invalid_choice(match: re.Match[str], _: Any) -> str:
    return choice_message(match[2], match[1], tuple(re.findall(r"'([^']*)'", match[3])))


def _not_a_number(kind: str) -> Callable[[re.Match[str], Any], str]:
    return lambda match, _: f"{match[1]}: got {match[2]}, allowed: {kind}; correct the value"


def _no_type(match: re.Match[str], advice: list[str]) -> str:
    """An option that may be left out says what is wrong further down, one line for each type."""
    end = next((i for i, line in enumerate(advice) if i and not line.strip("─")), len(advice))
    reason = re.search(r"(got .*, allowed: .*)", " ".join(advice[:end]))
    return f"{match[1]}: {reason[1] if reason else 'cannot be read'}; correct the value"


_REWRITES: tuple[tuple[str, Callable[[re.Match[str], list[str]], str]], ...] = (
    (r"Missing value for argument '(.+?)'", _missing_value),
    (r"Missing from .*?: (.*)", _missing_values),
    (r"Unrecognized (?:or misplaced )?options: (.*)", _unknown_option),
    (r"invalid choice '(.*)' for argument '(\S+)'. Expected one of (.*)", _invalid_choice),
    (r"Error parsing (\S+): invalid literal for int\(\) with base 10: (.*)",
     _not_a_number("a whole number")),
    (r"Error parsing (\S+): could not convert string to float: (.*)",
     _not_a_number("a number")),
    (r"Error parsing (\S+): Could not find valid parse for arguments: (.*)",
     _not_a_number("the values in --help")),
    (r"Error parsing (\S+): no type matching", _no_type),
    (r"Error parsing (\S+): (got .*, allowed: .*)",
     lambda match, _: f"{match[1]}: {match[2]}; correct the value"),
)  # fmt: skip
