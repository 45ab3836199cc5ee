# Every target builds the environment it needs first, so each works alone on a fresh clone.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed-from-lock
PIP := PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip
PEERS := .venv-peers
PEERS_PIP := PIP_DISABLE_PIP_VERSION_CHECK=1 $(PEERS)/bin/python -m pip
JOBS ?= 2

# One thread per process: the matrices are tiny, and threads of parallel workers fight for cores.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.DEFAULT_GOAL := help
.PHONY: help venv demo test fuzz lint format types docs wheel-check bench bench-check bench-calibration bench-drives bench-incremental bench-peers bench-paper bench-ranking bench-three-scans bench-throughput lock clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-18s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

venv: $(STAMP) ## build .venv from requirements.lock, with the project installed editable

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' || { \
	  echo "mht-slam needs CPython 3.11 to 3.14, for which GTSAM has wheels; name one with: make PYTHON=python3.11" >&2; \
	  exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet --require-hashes -r requirements.lock
	$(PIP) install --quiet --no-deps --no-build-isolation -e .
	@touch $@

demo: $(STAMP) ## the paper's scene from bearings to compared hypotheses: a table and figures
	$(BIN)/mht-slam demo

test: $(STAMP) ## every test and every example in the docstrings
	MPLBACKEND=Agg $(BIN)/python -m pytest -n $(JOBS)

fuzz: $(STAMP) ## 10,000 hostile inputs, each batch in an interpreter of its own: up to an hour
	MPLBACKEND=Agg $(BIN)/python tests/fuzz/campaign.py --examples 10000

lint: $(STAMP) ## ruff: rules and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(STAMP) ## let ruff repair what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# mypy knows nothing of `package-dir`, so it is shown the layout of the installed package.
types: $(STAMP) ## mypy --strict on the package as it is installed
	rm -rf build/typed && mkdir -p build/typed/mht_slam
	ln -s $(CURDIR)/mht_slam/* build/typed/mht_slam/
	ln -s $(CURDIR)/factors build/typed/mht_slam/factors
	cd build/typed && $(CURDIR)/$(BIN)/mypy --config-file $(CURDIR)/pyproject.toml \
	  --cache-dir $(CURDIR)/.mypy_cache/typed

docs: $(STAMP) ## links resolve inside the repository, examples run
	MPLBACKEND=Agg $(BIN)/python -m pytest tests/test_docs.py mht_slam factors README.md docs \
	  --doctest-glob='*.md'

wheel-check: $(STAMP) ## build a wheel, install it elsewhere, import and type-check it from there
	PYTHON=$(PYTHON) PIP_DISABLE_PIP_VERSION_CHECK=1 bash .ci/wheel-check

bench: $(STAMP) ## all methods on the same scenes, one HTML page: a quarter of an hour, goes on where it was
	$(BIN)/mht-slam bench compare --workers $(JOBS) --output runs/bench-compare

bench-check: $(STAMP) ## fails when a key figure got worse, a method disappeared, or a workload crashes
	$(BIN)/python benchmarks/gate/check.py --workers $(JOBS)

bench-calibration: $(STAMP) ## do probabilities come true: hours on two cores, goes on where it was
	$(BIN)/python benchmarks/calibration/calibration.py --workers $(JOBS)

# Peers have an environment of their own: what they need is none of ours to ask of anybody.
$(PEERS)/.installed: requirements.lock pyproject.toml benchmarks/peers/requirements.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS_PIP) install --quiet --require-hashes -r requirements.lock
	$(PEERS_PIP) install --quiet --no-deps -r benchmarks/peers/requirements.txt
	$(PEERS_PIP) install --quiet --no-deps --no-build-isolation -e .
	$(PEERS_PIP) check
	@touch $@

bench-peers: $(PEERS)/.installed ## peers by others on the same scenes: ten minutes, goes on where it was
	$(PEERS)/bin/python benchmarks/peers/compare.py --output runs/peers --workers $(JOBS)

bench-paper: $(STAMP) ## the paper's experiment: figures, tables, and which of its claims hold: minutes
	$(BIN)/python benchmarks/paper/paper_experiment.py --workers $(JOBS)

bench-drives: $(STAMP) ## whole drives, ceilings and baselines (needs the recordings), goes on where it was
	$(BIN)/python benchmarks/recordings/drives.py --workers $(JOBS)

bench-incremental: $(STAMP) ## cost of a scan on an idle machine, parameter draws, live probabilities (needs the recordings)
	$(BIN)/python benchmarks/recordings/incremental_cost.py
	$(BIN)/python benchmarks/recordings/parameter_draws.py --workers $(JOBS)
	$(BIN)/python benchmarks/recordings/live_calibration.py --workers $(JOBS)

bench-ranking: $(STAMP) ## exact ranking against exhaustive: half an hour, goes on where it was
	$(BIN)/python benchmarks/ranking/exact_against_exhaustive.py

bench-three-scans: $(STAMP) ## associations of three scans on real segments (needs the recordings)
	$(BIN)/python benchmarks/recordings/three_scans.py

bench-throughput: $(STAMP) ## hypotheses refined per second, against the bare optimiser: five minutes
	$(BIN)/python benchmarks/throughput/refinement.py --processes $(JOBS)

lock: $(STAMP) ## resolve requirements.lock anew
	$(PIP) install --quiet uv
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --extra dev --generate-hashes \
	  --no-emit-index-url --custom-compile-command "make lock" --upgrade \
	  --output-file requirements.lock pyproject.toml

clean: ## remove the environment, builds and caches
	rm -rf $(VENV) $(PEERS) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
