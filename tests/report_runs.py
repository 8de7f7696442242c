"""Run folders with curves that are known, as a report reads them."""

import dataclasses
import json

import numpy as np

from crsfd_jax.config import Config, Evaluation, to_dict
from crsfd_jax.options.randomisation import TRAINING
from crsfd_jax.report import cells as grouping
from crsfd_jax.report import runs
from crsfd_jax.report.methods import ARMS, BASELINES
from crsfd_jax.storage import metrics, trials

STEPS = tuple(range(100, 1100, 100))


def rising(start, top=1.0, seeds=5):
    """[T, S] success that rises from 0 within 300 steps, later for later seeds."""
    begin = start + 10 * np.arange(seeds)
    return np.clip((np.array(STEPS)[:, None] - begin) / 300, 0, 1) * top


def make_run(
    folder, method="crsfd", shape="2", shift=0.0, values=None, seed=0, steps=1000, every=1, **other
):
    """A run folder with success [T, S] at STEPS; `other` are options of the top level.

    Of the values the first of each `every` are left out: evaluations further apart.
    """
    values = (rising(200) if values is None else values)[every - 1 :: every]
    other["evaluation"] = Evaluation(every=100 * every)
    options = Config(
        algorithm=method,
        shape=shape,
        shift=shift * 1e-3,
        seed=seed,
        seeds=values.shape[1],
        steps=steps,
    )
    described = {"config": to_dict(dataclasses.replace(options, **other)), "device": "a machine"}
    described |= {"versions": {"jax": "1.2.3"}, "started": "2026-01-02T03:04:05"}
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(described))
    rows = [
        {"env_steps": step, "seed": seed + i, "eval/success_rate": rate, "time/wall_s": step / 10}
        for step, row in zip(STEPS[every - 1 :: every], values, strict=False)
        for i, rate in enumerate(row)
    ]
    metrics.append(folder / "metrics.csv", rows)
    return folder


def played(folder, *rows, options="--held-out --episodes 100", name="trials.csv"):
    """A table of trials (seed, shape, trials, successes) in the folder of a run."""
    table = [trials.Row(*row, options) for row in rows]
    trials.write(folder / name, table, "--csv")
    return folder


def transfer_run(folder, shape="2", successes=90, method="crsfd", shift=2.0, **options):
    """A run with a randomised arm, each of whose 5 policies inserts so often in 100 trials."""
    options = {"randomisation": TRAINING, **options}
    run = make_run(folder, method, shape, shift, **options)
    return played(run, *((seed, shape, 100, successes) for seed in range(5)))


def cells_of(*folders):
    return grouping.gather(runs.find(folders).runs)[0]


def paper_like(folder):
    """Runs of all cells of the paper that come out as it says."""
    for method in ("crsfd", *BASELINES):
        start = {"crsfd": 0, "sacfd": 400}.get(method, 500)
        top = {"crsfd": 1.0, "sacfd": 0.85, "sqil": 0.6}.get(method, 0.2)
        for shape in "1234":
            make_run(folder / f"{method}{shape}", method, shape, values=rising(start, top))
    for shape in "02":
        for shift, late in ((4, 5), (6, 200), (8, 400)):
            late += 200 * (shape == "2")
            place = f"{shape}{shift}"
            make_run(folder / f"c{place}", "crsfd", shape, shift, rising(0))
            values = rising(late, 1.0 if late == 5 else 0.9)
            make_run(folder / f"s{place}", "sacfd", shape, shift, values)
    for method in set(BASELINES) - {"sacfd"}:
        make_run(folder / f"{method}far", method, "2", 8, rising(500, 0.2))
    for arm in ARMS:
        for shape in "1234":
            make_run(folder / f"{arm}{shape}", arm, shape, values=rising(300))
