# SPDX-License-Identifier: Apache-2.0
# Needs make and Python 3.10 to 3.14; everything else is installed into $(VENV).
#   make demo    the paper's insertion over real ROS 2 topics, recorded, summarised, plotted
#   make test    the tests            make lint    style and types
#   make bench   the quick benchmarks make clean   remove what make and the tools made
# Another Python: make env PYTHON=python3.12

PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
STAMP = $(VENV)/.installed

# A sourced ROS workspace or another environment must not leak into this one.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
export AMENT_PREFIX_PATH = $(abspath $(VENV))

.PHONY: env demo test lint bench clean

env: $(STAMP)

# Editable, so that the commands always run the source as it is: only what setup.py says and what
# it compiles remake it.
COMPILED = $(wildcard needle_sim_ros/*/*.c)
$(STAMP): setup.py $(COMPILED) $(wildcard needle_sim_ros/*.h needle_sim_ros/*/*.h)
	@$(PYTHON) .ci/check_python.py
	@echo "Installing into $(VENV) (about 300 MB, one to three minutes) ..."
	@$(PYTHON) -m venv --clear "$(VENV)"
	@$(BIN)/python -m pip install -qq --disable-pip-version-check \
	    --editable ".[ros,test,lint]"
	@touch $@

demo: env
	$(BIN)/needle_sim demo

# Tests that go by a clock, or start processes, run with no other beside them.
ALONE = test/ros test/commands test/examples test/benchmark/test_speed.py test/benchmark/test_soak.py \
    test/identify/test_online.py test/session/test_recorder.py test/test_cli.py test/test_parallel.py
test: env
	$(BIN)/python -m pytest -n 2 --dist loadfile $(ALONE:%=--ignore=%)
	$(BIN)/python -m pytest $(ALONE)

lint: env
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy

bench: env
	mkdir -p out
	$(BIN)/needle_sim benchmark speed --quick --json out/speed.json
	$(BIN)/needle_sim benchmark accuracy --quick --json out/accuracy.json
	$(BIN)/needle_sim benchmark scaling --quick --json out/scaling.json
	$(BIN)/needle_sim benchmark stability --quick --json out/stability.json

# Recordings and results in demo/ and out/ stay.
clean:
	rm -rf .venv build install log *.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis
	rm -f $(COMPILED:.c=.*.so)
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
