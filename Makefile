# make train: sets up from nothing and learns shape 2 from demonstrations of shape 0
# make test:  sets up from nothing, then lint, types and tests
# make extras: also installs what only some need (Ray, submitit, wandb, the viewer), and tests that
PYTHON ?= python3
ARGS ?= --shape 2
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e
# A process for each core; tests of a file share what is slow to make.
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile

.PHONY: setup train test extras slow faults bench

setup: .venv/ready

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(INSTALL) ".[dev]"
	touch $@

train: setup
	$(BIN)/python -m crsfd_jax.train $(ARGS)

test: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(PYTEST)

extras: setup
	$(INSTALL) ".[ray,slurm,wandb,view,video]"
	$(PYTEST) tests/test_sweep.py tests/test_logging.py tests/test_viewer.py

slow: setup
	$(BIN)/python -m pytest -m slow

faults: setup
	$(PYTEST) -m faults

bench: setup
	$(BIN)/python bench/env.py
	$(BIN)/python bench/update.py
	$(BIN)/python bench/train.py
	$(BIN)/python bench/workers.py
