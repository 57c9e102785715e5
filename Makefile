# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
#
# make demo [PLANT=net3] [ARGS="--seed 3"]   control a plant end to end
# make test                                  all tests
# make check                                 lint, types, architecture, spelling
# make bench [BENCH="loop_rate plants"]      benchmarks (the others in benchmarks/ take longer)
# make colcon                                build the three packages with colcon
#
# Each sets up .venv by itself, once. Another interpreter: make PYTHON=python3.12 ...

PYTHON ?= python3
PLANT ?= wscc9
ARGS ?=
BENCH ?= loop_rate sliding monitors deepc
VENV := .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml $(wildcard msgs/*/* msgs/*.* packaging/* launch_scripts/*.py launch_scripts/config/*)

# A ROS environment of another venv in the shell must not leak into ours.
export LD_LIBRARY_PATH :=
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

.PHONY: demo test check bench colcon clean

demo: $(VENV)/.ready
	$(BIN)/ros2-deepc demo $(PLANT) $(ARGS)

test: $(VENV)/.ready-test
	$(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

check: $(VENV)/.ready-check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

bench: $(VENV)/.ready-bench
	set -e; for name in $(BENCH); do echo "== $$name"; $(BIN)/python benchmarks/$$name.py $(ARGS); done

colcon:
	sh packaging/colcon.sh $(PYTHON)

clean:
	rm -rf $(VENV) build install log

$(VENV)/.ready: $(SOURCES)
	sh packaging/venv.sh $(PYTHON) $(VENV)
	sh packaging/install.sh $(VENV)
	touch $@

$(VENV)/.ready-%: $(VENV)/.ready
	$(BIN)/python packaging/extra.py $* | xargs -d '\n' $(BIN)/python -m pip install --quiet --disable-pip-version-check
	touch $@
