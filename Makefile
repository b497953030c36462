# make demo | test | lint | site | experiments: each makes the environment it needs first. VENV=DIR puts that elsewhere,
# PYTHON=... chooses the interpreter, TESTS=... the tests. Experiments take half an hour and rebuild data/experiments.
VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check --no-compile

.PHONY: demo test lint site experiments clean
.DELETE_ON_ERROR:

demo: $(VENV)/.package
	$(BIN)/dvrk-cmaes demo

# as many processes as tests/conftest.py says: more threads of BLAS in each would only wait for each other; what one has
# compiled serves those that the tests start, also where the environment forbids to keep it
test: $(VENV)/.tools
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses=auto --dist=loadfile --no-loadscope-reorder $(TESTS)

lint: $(VENV)/.tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror dvrk_cmaes/kernel/*.?pp
	$(BIN)/mypy

site: $(VENV)/.package
	$(PIP) --editable '.[docs]'
	$(BIN)/python scripts/make_site.py

experiments: $(VENV)/.tools
	$(BIN)/python scripts/experiment.py table1
	$(BIN)/python scripts/experiment.py figure4
	$(BIN)/python scripts/experiment.py table2
	$(BIN)/python scripts/measure.py write

clean:
	rm -rf $(VENV)

$(VENV)/.python:
	@$(PYTHON) scripts/check_build_tools.py
	$(PYTHON) -m venv $(VENV)
	@touch $@

# the kernel is compiled when the package is installed
KERNEL := dvrk_cmaes/kernel/CMakeLists.txt $(wildcard dvrk_cmaes/kernel/*.?pp)

$(VENV)/.package: $(VENV)/.python pyproject.toml $(KERNEL)
	$(PIP) --editable .
	@touch $@

# with the package, which need not be installed by itself before
$(VENV)/.tools: $(VENV)/.python pyproject.toml $(KERNEL)
	$(PIP) --editable '.[test,lint,make]'
	@touch $(VENV)/.package $@
