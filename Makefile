# make train: sets up from nothing and learns shape 2 from demonstrations of shape 0
# make test:  sets up from nothing, then lint, types and tests
PYTHON ?= python3
ARGS ?= --shape 2
BIN := .venv/bin

.PHONY: setup train test slow faults bench

setup: .venv/ready

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

train: setup
	$(BIN)/python -m crsfd_jax.train $(ARGS)

test: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/python -m pytest

slow: setup
	$(BIN)/python -m pytest -m slow

faults: setup
	$(BIN)/python -m pytest -m faults

bench: setup
	$(BIN)/python bench/env.py
	$(BIN)/python bench/update.py
	$(BIN)/python bench/train.py
