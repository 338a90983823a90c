# Everything runs in .venv/ beside this file; each target makes what it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# Tests start the command line hundreds of times; without bytecode each start compiles the whole package.
unexport PYTHONDONTWRITEBYTECODE
SOURCES := $(shell find src -name '*.py' 2>/dev/null)

.PHONY: demo test test-all check bench docs clean help

help:
	@echo 'make demo   install, and render the built-in sample to out/'
	@echo 'make test   install what the tests need, and run them'
	@echo 'make test-all  also the long ones: fuzzing, kills, concurrent runs, windows, notebooks'
	@echo 'make check  ruff, mypy and the direction of imports'
	@echo 'make bench  the benchmarks, as tables; QUICK=1: the main ones in small forms, ten minutes at most'
	@echo 'make docs   the documentation site, its gallery and tutorials run, in site/'
	@echo 'make clean  remove .venv/ and what was made'

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'Orograph needs Python 3.11 or newer: make PYTHON=python3.12 …'; exit 1; }
	$(PYTHON) -m venv $(VENV)

# One stamp per set of extras: a second run installs nothing.
$(VENV)/.%: pyproject.toml requirements.lock | $(BIN)/python
	$(PIP) install --quiet --constraint requirements.lock --editable '.[$*]'
	@touch $@

demo: $(VENV)/.sample
	@$(BIN)/orograph demo --output out

test: $(VENV)/.test
	$(BIN)/python -m pytest -n auto --dist worksteal $(PYTEST_ARGS)

test-all: $(VENV)/.test
	$(BIN)/python -m pytest -n auto --dist worksteal -m '' $(PYTEST_ARGS)

check: $(VENV)/.check $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.bench
	@$(BIN)/python bench/every.py $(if $(QUICK),--quick)

docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs site

clean:
	rm -rf $(VENV) out build dist site docs/made docs/sg_execution_times.rst *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
