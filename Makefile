# Each command sets itself up: the environment is made anew when constraints.txt or pyproject.toml change.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
SUPPLY := build/supply
KEY := $(shell cat constraints.txt pyproject.toml | cksum | cut -d' ' -f1)
STAMP := $(VENV)/.installed-$(KEY)
export PATH := $(CURDIR)/$(VENV)/bin:$(PATH)
export MLFLOW_DISABLE_TELEMETRY := true
# Data sets that others published are taken from this folder if it lies beside the checkout; else they are fetched.
export HDSP_DATA_DIR ?= $(abspath $(wildcard ../shared/data))
# Threads of torch that wait give their core away: beside another process, training loses less time.
export OMP_WAIT_POLICY ?= passive
TEST_ARGS ?=
FUZZ_SECONDS ?= 600
FUZZ_SEED ?= 0
FUZZ_ARGS ?=
# Tests of all kernels, without the slow ones that run no kernel of their own.
KERNEL_TESTS := tests/detailed tests/abstract/test_prepared_graph.py tests/abstract/test_bucket_ring.py \
	tests/labels/test_rules.py tests/planning/test_heuristics.py tests/learning/test_dense_edges.py::test_patches_of_a_rotated_map \
	tests/learning/test_footprint_engine.py::test_a_network_with_other_widths_and_channels \
	tests/terrain/test_cost_maps.py tests/terrain/test_patches.py tests/terrain/test_sensor_model.py \
	tests/terrain/simulation/test_lidar_mapping.py \
	--ignore tests/detailed/test_staircases.py
# Tests on maps so small that they take a minute without the JIT.
PLAIN_TESTS := tests/detailed/test_store.py tests/detailed/test_geometry.py tests/detailed/test_small_actions.py \
	tests/detailed/test_small_searches.py tests/abstract/test_bucket_ring.py
# Half of the test maps: they run all kernels.
KERNEL_MAPS := not (cuboid_2 or cuboid_3 or wall_2 or staircase_wall or staircase_focused)

.PHONY: help install repro demo tables experiments runs publish docs docs-links test test-checked warm-checked nightly mutants fuzz audit sbom hashes lint format params clean

help:  ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 10

repro: $(STAMP)  ## run the pipeline (only what changed) and print the paper's tables beside ours, and seconds by stage
	@python -m pipeline.rwlock
	dvc repro
	@cat reports/tables.md
	@python -m pipeline.seconds
	@echo "reports/index.html: tables, pictures, paths in 3D, data and hashes in one file"

install: $(STAMP)  ## the environment alone

demo: $(STAMP)  ## a robot climbs stairs in the browser
	hdsp demo

tables: $(STAMP)  ## print the tables of the last run
	@cat reports/tables.md

experiments: $(STAMP)  ## one line per experiment of DVC: the parameters and results that differ
	dvc exp show --only-changed --no-pager

runs: $(STAMP)  ## all trainings side by side in the browser, in MLflow, until Ctrl-C
	@python -c "from pipeline.run_view import ADDRESS; print(f'http://127.0.0.1:5000/{ADDRESS}')"
	mlflow ui --backend-store-uri sqlite:///mlflow.db --workers 1

publish: $(STAMP)  ## write the tables of the last run into README.md and docs/results.md
	python -m pipeline.publish_pages

docs: $(STAMP)  ## the documentation as a site in build/docs: notebooks run, each warning is an error
	sphinx-build -q -E -W --keep-going -b html docs build/docs
	@echo "build/docs/index.html"

docs-links: $(STAMP)  ## the addresses of other sites in the documentation, each fetched once (needs a network)
	sphinx-build -q -b linkcheck -D nb_execution_mode=off docs build/links

test: $(STAMP)  ## all tests but the long ones, which `make nightly` runs too
	python -m pytest --numprocesses 2 --dist loadgroup -m "not nightly" $(TEST_ARGS)

# Compiled for itself: with checks of every index, which a kernel otherwise goes without.
test-checked warm-checked: export NUMBA_BOUNDSCHECK := 1
test-checked warm-checked: export OMP_NUM_THREADS := 1
test-checked warm-checked: export NUMBA_CACHE_DIR := $(CURDIR)/$(VENV)/numba-checked
test-checked: $(STAMP)  ## the tests of the kernels, with every index checked
	python -m pytest --numprocesses 2 --dist loadgroup $(KERNEL_TESTS) -k "$(KERNEL_MAPS)" $(TEST_ARGS)

warm-checked: $(STAMP)  # one process compiles for both of the tests
	hdsp warmup

nightly: export OMP_NUM_THREADS := 1
nightly: $(STAMP)  ## for a night: all tests with every index checked, small kernels not compiled, fuzzing, faults
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/$(VENV)/numba-checked \
		python -m pytest --numprocesses 2 --dist loadgroup $(TEST_ARGS)
	NUMBA_DISABLE_JIT=1 python -m pytest $(PLAIN_TESTS)
	$(MAKE) fuzz
	python -m tests.faults --most 4

mutants: $(STAMP)  ## mutation testing of both searches and of the actions; a later run goes on
	python -m tests.mutants

fuzz: $(STAMP)  ## damaged files, random plans and updates for FUZZ_SECONDS (600), from case FUZZ_SEED (0) on
	python -m tests.fuzz --seconds $(FUZZ_SECONDS) --seed $(FUZZ_SEED) $(FUZZ_ARGS)

# Tools for the supply have an environment of their own, so that constraints.txt pins none of their packages.
$(SUPPLY)/.installed: Makefile
	test -x $(SUPPLY)/bin/python || $(PYTHON) -m venv $(SUPPLY)
	$(SUPPLY)/bin/python -m pip install --quiet "pip-audit>=2.10" "cyclonedx-bom>=7.5"
	touch $@

audit: $(SUPPLY)/.installed  ## compare every pinned package with published advisories (needs a network)
	$(SUPPLY)/bin/python tools/audit.py

sbom: $(SUPPLY)/.installed  ## list of all packages of the environment in build/sbom.json (CycloneDX)
	mkdir -p build
	$(SUPPLY)/bin/cyclonedx-py requirements --pyproject pyproject.toml --of JSON -o build/sbom.json constraints-hashes.txt
	@echo "build/sbom.json"

hashes: $(SUPPLY)/.installed  ## constraints.txt with the hashes of all files in constraints-hashes.txt (needs a network)
	$(SUPPLY)/bin/python tools/hashes.py

lint: $(STAMP)  ## style, types, layers of imports, words of docstrings
	ruff check .
	ruff format --check --diff .
	mypy
	lint-imports
	python tools/docstring_words.py

format: $(STAMP)
	ruff check --fix .
	ruff format .

params: $(STAMP)  ## compose conf/ into params.yaml
	python -m pipeline.config

clean:  ## remove everything that can be made again (environment, data, models, experiment tracking)
	rm -rf $(VENV) data models outputs mlartifacts mlflow.db .dvc/cache .dvc/tmp

# torch first: a later package would otherwise pull the newest build of it, with several GB of CUDA.
$(STAMP): constraints.txt pyproject.toml
	@echo "setting up $(VENV) with $(PYTHON); this takes a few minutes"
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet "$$(grep '^torch==' constraints.txt)"
	$(VENV)/bin/python -m pip install --quiet --constraint constraints.txt --editable ".[all]"
	rm -f $(VENV)/.installed-*
	touch $(STAMP)
