"""`python -m crsfd_jax.export RUN --format onnx --check`: a policy for a robot without JAX."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from crsfd_jax import cli, extras
from crsfd_jax.errors import DONE, MISSED

_NEEDS = {"onnx": ("onnx", "onnxruntime"), "stablehlo": ("flatbuffers",)}


@dataclass(frozen=True)
class Export:
    """Writes the deterministic policy of one seed, with all that its user must know beside it."""

    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")]
    """Folder of the run."""
    format: Literal["onnx", "npz", "stablehlo"] = "npz"
    """File format: npz needs numpy only to run, stablehlo needs JAX or another XLA."""
    seed: str = "best"
    """Seed to export: a number, or best for the one with the most success."""
    out: str = ""
    """Folder to write to, one for each format; empty for export/FORMAT in the run's folder."""
    check: bool = False
    """Compare the file with the trained policy on 1,000 observations; exit code 1 if unequal."""


def run(argv: list[str]) -> int:
    """Exports as the command line says; see --help."""
    options = cli.parse(Export, argv)
    if options.format in _NEEDS:
        extras.require(f"--format {options.format}", options.format, *_NEEDS[options.format])
    from crsfd_jax.deploy import export

    exported = export.export(options.run, options.format, options.seed, options.out)
    print(f"wrote {exported.path} and {export.CONTRACT} beside it, seed {exported.seed}")
    if not options.check:
        return DONE
    difference = export.largest_difference(exported)
    print(
        f"largest difference {difference:.2e} on {export.OBSERVATIONS} observations, "
        f"allowed {export.TOLERANCE:.0e}"
    )
    return DONE if difference <= export.TOLERANCE else MISSED


if __name__ == "__main__":
    cli.main(run)
