# Everything runs in .venv, made on first use: pinned packages and this package, editable.
# Another Python: make test PYTHON=python3.12. Where ROS is sourced (ROS_DISTRO set), its rclpy is used, not the wheels.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

ifdef ROS_DISTRO
ROS := $(ROS_DISTRO)
VENV_FLAGS := --system-site-packages
REQUIREMENTS := requirements.txt
else
ROS := wheels
VENV_FLAGS :=
REQUIREMENTS := requirements.txt requirements-ros.txt
endif

# Stamps, each written last, so that an interrupted installation is done again; named for what .venv was made from.
PACKAGES := $(VENV)/packages-$(subst /,_,$(PYTHON))-$(ROS)
READY := $(PACKAGES)-ready
KERNELS := $(PACKAGES)-kernels
VIEW := $(PACKAGES)-view
DEV := $(PACKAGES)-dev
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input --quiet install
# Bytecode on all cores and without the libraries' own tests takes half of pip's time.
COMPILE := $(BIN)/python -m compileall -q -q -j 0 -x '/tests?/' $(VENV)/lib

.PHONY: demo view test soak repeat lint bench bench-peers docs install clean help

demo: $(KERNELS)  ## the main job: simulated arm, node and target streamer over DDS, recorded, replayed, drawn
	@$(BIN)/ik_controller demo

view: $(KERNELS) $(VIEW)  ## a simulated arm in the browser: drag its target
	@$(BIN)/ik_controller view --sim

# Two at a time, a file as a whole: most tests wait for processes more than they compute. A worker that dies ends the run:
# what it had started still lives, and its successor would meet it.
test: $(KERNELS) $(DEV)  ## the test suite
	@$(BIN)/python -m pytest -m "not soak" -n 2 --dist loadfile --max-worker-restart 0

soak: $(KERNELS) $(DEV)  ## checks too long for every day
	@$(BIN)/python -m pytest -m soak

repeat: $(KERNELS) $(DEV)  ## every test over DDS 20 times in a row, with two busy processes beside it
	@$(BIN)/python scripts/repeat_tests.py --times 20 --load 2 test/ros

lint: $(READY) $(DEV)  ## ruff and mypy
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

bench: $(KERNELS)  ## benchmarks
	@$(BIN)/ik_controller bench

bench-peers: $(KERNELS)  ## the same jobs by other libraries, each in an environment of its own
	@$(BIN)/python test/benchmark/peers

docs: $(KERNELS)  ## the parts of the documentation that are made from the code
	@$(BIN)/python scripts/make_docs.py
	@$(BIN)/python scripts/make_views.py
	@set -e; for script in docs/pictures*.py; do $(BIN)/python $$script; done

install: $(KERNELS) $(DEV)  ## .venv alone

clean:  ## remove .venv and what builds leave behind; recorded runs stay
	@rm -rf $(VENV) $(VENV)-peers build install log dist *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache
	@find ik_controller test scripts launch -name __pycache__ -prune -exec rm -rf {} +

help:  ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1|\2/p' Makefile | column -t -s '|'

$(PACKAGES): $(REQUIREMENTS) scripts/check_python.py
	@command -v $(PYTHON) >/dev/null || { echo "make: $(PYTHON) not found: install Python 3.10-3.13 or say which: make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) scripts/check_python.py
	@echo "Setting up $(VENV) with $$($(PYTHON) --version): once, a minute or two ..."
	@$(PYTHON) -m venv --clear $(VENV_FLAGS) $(VENV)
	@$(PIP) --no-compile $(REQUIREMENTS:%=-r %)
	@$(COMPILE) || true
	@touch $@

$(READY): $(PACKAGES) setup.py pyproject.toml
	@$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

$(KERNELS): $(READY) $(wildcard ik_controller/control/*.py ik_controller/kinematics/*.py)
	@echo "Compiling the control kernels that have changed ..."
	@$(BIN)/python scripts/warm_up.py
	@touch $@

$(VIEW): $(PACKAGES) requirements-view.txt
	@echo "Adding what the live page needs: once ..."
	@$(PIP) -r requirements-view.txt
	@touch $@

$(DEV): $(PACKAGES) $(VIEW) requirements-dev.txt
	@echo "Adding what tests and lint need: once ..."
	@$(PIP) -r requirements-dev.txt
	@touch $@
