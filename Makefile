# Everything runs in .venv, which the targets create by themselves.
# Needs: make, and Python >= 3.11 with its venv module (make PYTHON=python3.12 ... to choose one).

PYTHON ?= python3

VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: help paper sweep suite library reports golden bench bench-check frameworks matching drive agreement test test-long test-all coverage lint format typecheck keys pictures turbulence docs tutorial tutorial-check wheel-check browser lock clean

help:
	@echo "make paper        fly the paper's three cases, 10 runs each; the report is in results/wang2013/report"
	@echo "make sweep        run the scenario noise_rate_sweep; its report is in results/noise_rate_sweep/report"
	@echo "make suite        run the standard suite; writes the stored runs of ggbench score (an hour)"
	@echo "make library      run every scenario, or go on where that stopped; then make reports"
	@echo "make reports      renew the committed pages of reports/ from results/"
	@echo "make golden       write tests/golden.json, the numbers of every estimator on short flights"
	@echo "make bench        compare the speed of the engines with other packages; writes reports/speed.md"
	@echo "make frameworks   compare estimation frameworks; writes reports/frameworks.md"
	@echo "make bench-check  check in a minute that the engines' ratios have not fallen"
	@echo "make matching     fly over 128 cells of two maps; writes reports/matching_area.md (20 minutes)"
	@echo "make drive        fly a recorded drive with GNSS outages; writes reports/recorded_drive.md"
	@echo "make agreement    hold the compiled engines to the frameworks on every case (half an hour)"
	@echo "make test         run the tests, on all processors"
	@echo "make test-all     run these and the long ones: agreement on scenarios of each kind, loops of faults"
	@echo "make coverage     run the tests, and write which lines none of them runs to build/coverage"
	@echo "make lint         check style and format"
	@echo "make format       apply style fixes and format"
	@echo "make typecheck    check the type annotations"
	@echo "make keys         write the tables of docs/scenario_files.md and the JSON schemas"
	@echo "make pictures     draw the pictures of docs/concepts"
	@echo "make turbulence   fly the tracks of the scenario turbulence again, by JSBSim"
	@echo "make docs         build the documentation into build/docs; a warning is an error"
	@echo "make tutorial     execute docs/tutorial.ipynb and keep its outputs"
	@echo "make tutorial-check  execute it and compare the outputs with those that are kept"
	@echo "make wheel-check  build the wheel, install it in an empty environment and use it"
	@echo "make browser      install Chromium, with which pages are tested, where apt-get can"
	@echo "make lock         renew requirements.lock with the newest versions allowed"
	@echo "make clean        remove the environment and what the tools built; results/ stays"

PAPER_CASES := -c 0.01E-1Hz -c 0.001E-1Hz -c 0.01E-0.2Hz
GRAPHS_AND_FILTERS := -e ekf -e ukf -e factor-graph[mode=batch] -e factor-graph[mode=fixed-lag] -e factor-graph -e @frameworks

paper: $(INSTALLED)
	$(BIN)/ggbench run wang2013 -n 10 $(PAPER_CASES) -e ins $(GRAPHS_AND_FILTERS) --fresh -o results/wang2013
	$(BIN)/ggbench report results/wang2013 -o results/wang2013/report

sweep: $(INSTALLED)
	$(BIN)/ggbench run noise_rate_sweep --fresh -o results/noise_rate_sweep
	$(BIN)/ggbench report results/noise_rate_sweep -o results/noise_rate_sweep/report

suite: $(INSTALLED)
	$(BIN)/ggbench run suite -o results/suite
	$(BIN)/python -m ggbench.score.stored_runs results/suite scenarios/data/suite_runs.npz

library: $(INSTALLED)
	$(BIN)/ggbench run --all --assumptions -o results
	$(MAKE) reports

reports: $(INSTALLED)
	$(BIN)/ggbench report --all results -o reports

golden: $(INSTALLED)
	$(BIN)/python tests/test_golden.py

# Environments of other packages are made in build/speed; without a network it goes on without them.
bench: $(INSTALLED)
	PYTHONPATH=benchmarks:tests $(BIN)/python -m speed

frameworks: $(INSTALLED)
	PYTHONPATH=benchmarks:tests $(BIN)/python -m frameworks

bench-check: $(INSTALLED)
	PYTHONPATH=benchmarks:tests $(BIN)/python -m speed --check

matching bench bench-check frameworks: export OPENBLAS_NUM_THREADS := 1
matching: $(INSTALLED)
	PYTHONPATH=studies $(BIN)/python -m matching_area

drive: $(INSTALLED)
	PYTHONPATH=studies $(BIN)/python -m recorded_drive

agreement: $(INSTALLED)
	GGBENCH_TEST_AGREEMENT=all $(BIN)/python -m pytest -m "" tests/engines/test_agreement.py

# One thread of linear algebra per process: more only get into each other's way.
test test-long coverage agreement: export OPENBLAS_NUM_THREADS := 1
# Bytecode of the tests is kept, wherever Python is set to leave none, and out of the folders:
# to rewrite and compile them again costs each process five seconds.
test test-long coverage agreement: export PYTHONDONTWRITEBYTECODE :=
test test-long coverage agreement: export PYTHONPYCACHEPREFIX := $(CURDIR)/build/bytecode

# A file's tests stay in one process, in their order: what they share is made once. Of the long
# tests two processes more than there are processors, for many wait for processes that they start.
processes = $(shell $(BIN)/python -c "import os; print(min(os.cpu_count() + $(1), 8))")
in_parallel = pytest -n $(call processes,$(1)) --dist loadfile --no-loadscope-reorder

test: $(INSTALLED)
	$(BIN)/python -m $(call in_parallel,0)

test-long: $(INSTALLED)
	$(BIN)/python -m $(call in_parallel,2) -m long --durations=60 --durations-min=5

test-all: test test-long

coverage: $(INSTALLED)
	mkdir -p build/coverage
	$(BIN)/python -m coverage run -m $(call in_parallel,0)
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report --skip-covered --show-missing

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# mypy knows no mapping of folders to packages, so the package is laid out for it with links.
typecheck: $(INSTALLED)
	rm -rf build/typecheck
	mkdir -p build/typecheck/ggbench
	cd build/typecheck/ggbench && ln -s $(addprefix ../../../,$(filter-out %/__pycache__,$(wildcard ggbench/*)) estimators scenarios) .
	$(BIN)/mypy -p ggbench

keys: $(INSTALLED)
	$(BIN)/python docs/scripts/key_tables.py

pictures: $(INSTALLED)
	$(BIN)/python docs/scripts/pictures.py

turbulence: $(INSTALLED)
	PYTHONPATH=studies $(BIN)/python -m turbulence

# Everything that it reads is here: it needs no network.
docs: $(INSTALLED)
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --nitpicky --quiet -c docs/scripts -b html docs build/docs

tutorial tutorial-check: export OPENBLAS_NUM_THREADS := 1
tutorial: $(INSTALLED)
	$(BIN)/python docs/scripts/tutorial.py --write

tutorial-check: $(INSTALLED)
	$(BIN)/python docs/scripts/tutorial.py

wheel-check: $(INSTALLED)
	tests/check_wheel.sh $(BIN)/python

# Tests of pages in a browser skip without one. Chromium is the system's: nothing is downloaded past
# its packages.
browser:
	@if { command -v chromium || command -v chromium-browser || command -v google-chrome; } >/dev/null; then \
		echo "a browser is there already"; \
	elif command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ]; then \
		apt-get -o Acquire::http::Timeout=30 update -qq && apt-get -o Acquire::http::Timeout=30 install -y -qq --no-install-recommends chromium poppler-utils; \
	else \
		echo "install Chromium with the system's packages, as root: apt-get install chromium"; exit 1; \
	fi

$(INSTALLED): pyproject.toml requirements.lock
	@command -v "$(PYTHON)" >/dev/null || \
		{ echo "$(PYTHON): not found. Choose a Python >= 3.11: make PYTHON=/path/to/python" >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "ggbench needs Python >= 3.11, and $(PYTHON) is $$("$(PYTHON)" -V 2>&1)." \
		       "Choose another: make PYTHON=/path/to/python" >&2; exit 1; }
	"$(PYTHON)" -m venv $(VENV)
	$(PIP_INSTALL) -r requirements.lock
	$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

# The lock is what a fresh environment gets, setuptools included and the installer left out.
lock:
	rm -rf build/lock
	"$(PYTHON)" -m venv build/lock
	build/lock/bin/python -m pip install --quiet --upgrade "pip>=25.1"
	build/lock/bin/python -m pip install --quiet . --group test --group docs --group dev
	{ echo "# Exact versions for the make targets; renewed by: make lock"; \
	  build/lock/bin/python -m pip freeze --all --exclude pip --exclude ggbench; } \
		>build/requirements.lock
	mv build/requirements.lock requirements.lock
	rm -rf build/lock

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find benchmarks ggbench estimators scenarios studies tests -name __pycache__ -prune -exec rm -rf {} +
