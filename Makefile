# Each command sets itself up: the environment is made anew when constraints.txt or pyproject.toml change.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
KEY := $(shell cat constraints.txt pyproject.toml | cksum | cut -d' ' -f1)
STAMP := $(VENV)/.installed-$(KEY)
export PATH := $(CURDIR)/$(VENV)/bin:$(PATH)
export MLFLOW_DISABLE_TELEMETRY := true
# Data sets that others published are taken from this folder if it lies beside the checkout; else they are fetched.
export HDSP_DATA_DIR ?= $(abspath $(wildcard ../shared/data))
TEST_ARGS ?=

.PHONY: help repro tables test lint format params clean

help:  ## this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 10

repro: $(STAMP)  ## run the pipeline (only what changed) and print the paper's tables beside ours
	dvc repro
	@cat reports/tables.md

tables: $(STAMP)  ## print the tables of the last run
	@cat reports/tables.md

test: $(STAMP)  ## all tests
	python -m pytest --numprocesses 2 --dist loadgroup $(TEST_ARGS)

lint: $(STAMP)  ## style and simple errors
	ruff check .
	ruff format --check --diff .

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
