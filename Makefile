# make demo      set up, replay the recorded drive through the nodes, print the calibration
# make demo-arm  the same with the recorded moves of an arm
# make demo-track  follow the recorded object through the nodes, print the errors of the poses
# make test      set up, run the tests in ten minutes or less
# make test-all  the same with those that take long: before a release, and where you change an estimate
# make lint      style and types only
# make docs      build the site of the documents in out/site
# make bench     print every figure that the README claims
# make clean     remove what the others made

VENV := .venv
BIN := $(VENV)/bin
# one interpreter, at least 3.11 and able to make virtual environments
PYTHON ?= $(shell for python in python3.12 python3.11 python3.13 python3; do \
	$$python -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' \
	2>/dev/null && echo $$python && break; done)
PIP_QUIET := --quiet --disable-pip-version-check
PYTEST_ARGS ?=
# there are ROS wheels for this platform: a test of ROS that is left out is a fault
REQUIRE := $(if $(filter Linux-x86_64,$(shell uname -sm | tr ' ' -)),--require ros)

SOURCES := setup.py setup.cfg pyproject.toml package.xml README.md \
	$(shell find selfcal_ros msg_adapters launch config scripts bags -type f \
	-not -name '*.pyc' 2>/dev/null)

# NumPy's threads gain nothing on matrices this small, and cost much when tests run side by side
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# tests start the same programs again and again: each is compiled once, also for those who
# otherwise let Python leave no compiled files behind
test test-all: export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo demo-arm demo-track test test-all lint docs bench clean help

demo: $(VENV)/package
	@$(BIN)/selfcal demo --output-dir out/demo --force

demo-arm: $(VENV)/package
	@$(BIN)/selfcal demo --recording arm --output-dir out/demo-arm --force

demo-track: $(VENV)/package
	@$(BIN)/selfcal demo --recording object --output-dir out/demo-track --force

RUN_TESTS := ROS_PYTHON_CHECK_FIELDS=1 $(BIN)/python -m pytest -n 2 --dist worksteal \
	--max-worker-restart 2 $(REQUIRE)

test: $(VENV)/package $(VENV)/test-tools
	$(RUN_TESTS) -m 'not long and not linter' --durations 20 --durations-min 3 $(PYTEST_ARGS)

test-all: $(VENV)/package $(VENV)/test-tools
	$(RUN_TESTS) $(PYTEST_ARGS)

lint: $(VENV)/test-tools
	$(BIN)/python -m flake8 .
	$(BIN)/python -m mypy

docs: $(VENV)/test-tools
	$(BIN)/python -m mkdocs build --strict

bench: $(VENV)/package $(VENV)/test-tools
	$(BIN)/python -m bench

clean:
	rm -rf $(VENV) build out *.egg-info .pytest_cache .hypothesis .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

help:
	@sed -n '/^# make/s/^# //p' Makefile

# Three stamps, so that the second run starts at once: the environment with everything that we
# depend on, the package itself (again whenever a source file changes), and the test tools.
$(VENV)/dependencies: setup.py
	@if [ -z "$(PYTHON)" ]; then \
	  echo "No Python >= 3.11 that can make virtual environments was found." >&2; \
	  echo "Debian and Ubuntu: sudo apt-get install python3-venv" >&2; \
	  echo "Elsewhere: install Python 3.11 or 3.12, or name one: make PYTHON=/path/to/python3" >&2; \
	  exit 1; fi
	@echo "Setting up $(VENV) with $$($(PYTHON) --version): about a minute, once ..."
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install $(PIP_QUIET) '.[ros-wheels]'
	@touch $@

$(VENV)/package: $(VENV)/dependencies $(SOURCES)
	@$(BIN)/python -m pip install $(PIP_QUIET) --no-deps --force-reinstall .
	@rm -rf build selfcal_ros.egg-info
	@touch $@

$(VENV)/test-tools: $(VENV)/dependencies
	@$(BIN)/python -m pip install $(PIP_QUIET) '.[test]'
	@touch $@
