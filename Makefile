# Everything people type. `make test` is also what CI runs.
VENV ?= .venv
EDGE_VENV ?= .venv-edge
BIN := $(VENV)/bin
TESTSET ?= testset
JOBS ?= 2

.PHONY: help setup demo test lint types unit edge test-full fuzz stability pareto peers format clean

help:           ## list the targets
	@grep -E '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: $(VENV)/.installed ## virtual environment with everything the tests need

$(VENV)/.installed: pyproject.toml constraints.txt
	python3 -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev,export,denoise,scene,training,bench,service,openvino]'
	touch $@

demo:           ## relight a scene that comes along from eight directions: demo.png
	test -x $(BIN)/spotlight || python3 -m venv $(VENV)
	test -x $(BIN)/spotlight || $(BIN)/pip install --quiet --constraint constraints.txt --editable '.[scene]'
	$(BIN)/spotlight demo --scene berries -o demo.png

test: lint types unit edge ## all that must pass before a change lands

lint: setup     ## style and import boundaries
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: setup    ## static types, strict on specification and runtime
	$(BIN)/mypy

unit: setup     ## unit and property tests with coverage, then export, parity and the README, then the page
	$(BIN)/pytest -m 'not full' -n $(JOBS) --dist loadfile tests/spec tests/runtime --cov --cov-report=term
	$(BIN)/pytest -m 'not full' -n $(JOBS) --dist loadfile --ignore=tests/spec --ignore=tests/runtime --ignore=tests/page
	$(BIN)/pytest -m 'not full' tests/page

edge:           ## build the wheel, install it without torch, run the runtime's tests on it
	python3 -m venv --clear $(EDGE_VENV)
	rm -rf dist
	$(EDGE_VENV)/bin/pip wheel --quiet --no-deps --wheel-dir dist .
	$(EDGE_VENV)/bin/pip install --quiet --constraint constraints.txt dist/*.whl hypothesis onnx pytest pytest-xdist
	$(EDGE_VENV)/bin/python -c "import importlib.util as u; assert u.find_spec('torch') is None"
	$(EDGE_VENV)/bin/python -P -m pytest -m 'not full' -n $(JOBS) --dist loadfile tests/spec tests/runtime

pareto: setup   ## what accuracy costs in time: curve, table, and the ladder that budgets climb
	$(BIN)/spotlight-bench pareto $(TESTSET) -o pareto --json pareto/all.json --resume --ladder runtime/spotlight_runtime/planning/ladder.json

peers: setup    ## against diffusers, OpenVINO and a plain export: an hour and a half, 16 GB of memory
	$(BIN)/spotlight-bench peers --size mini -o peers --json peers/all.json
	$(BIN)/spotlight-bench peers --size full -o peers-full --json peers-full/all.json

test-full: setup ## full-size export, verification and relight: half an hour, 16 GB of memory
	$(BIN)/pytest -m full -s

fuzz: setup     ## coverage-guided fuzzing of every parser: half an hour, goes on where it ended
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev,scene,fuzz]'
	PYTHONPATH=tests $(BIN)/python -m fuzz.guided --minutes $(or $(MINUTES),35)

stability: setup ## docs/stability.md's tables and plot: hard cases, error growth, sensitivity
	$(BIN)/spotlight-bench stability -o docs
	PYTHONPATH=tests $(BIN)/python -m hard_cases.report docs/stability.md

format: setup   ## rewrite in the house style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:          ## remove what the targets made
	rm -rf $(VENV) $(EDGE_VENV) dist .pytest_cache .mypy_cache .ruff_cache .coverage
