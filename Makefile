# Everything is set up by these targets: they make .venv from the locked dependencies and install this package in it.
# Needed beforehand: Python 3.11+, git, make. `make` alone lists the targets.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.PHONY: help venv grasp bench quasistatic docs first test test-all slow lint types contracts pytest sanitize wheels lock clean

# The first of these that is Python 3.11 or newer; override with `make PYTHON=/path/to/python`.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
export OPENBLAS_NUM_THREADS ?= 1
PYRIGHT = $(BIN)/pyright --warnings --level error
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
# Python compiles a module when it is imported first. Compiling all modules of all packages takes a third of the installation.
INSTALL := $(PIP) install --no-compile
OUT ?= runs/grasp
ARGS ?=

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile | expand -t 18

grasp: $(VENV)/.run-ready  ## grasp an egg in simulation; results in runs/grasp, later in runs/grasp-TIME (ARGS="--object vial" and so on)
	$(BIN)/mjtactile grasp --out $(if $(wildcard $(OUT)/recording),$(OUT)-$(shell date +%Y%m%d-%H%M%S),$(OUT)) $(ARGS)

bench: $(VENV)/.run-ready  ## measure the grasp and the perception; results in bench-results, docs/, README.md
	$(BIN)/mjtactile bench grasp --out bench-results --readme $(ARGS)
	$(BIN)/mjtactile bench perception --out bench-results --readme $(ARGS)
	$(BIN)/mjtactile bench benchmark-index --out bench-results --readme
	$(BIN)/mjtactile bench readme-table --out bench-results --readme

film: $(VENV)/.test-ready  ## the video of the README (docs/images/grasp.webp) and the summary in the gallery
	rm -rf runs/film runs/film.webp
	$(BIN)/mjtactile grasp --out runs/film --video runs/film.webp $(ARGS)
	mv runs/film.webp docs/images/grasp.webp
	cp runs/film/summary.png docs/images/grasp.png

docs: $(VENV)/.docs-ready  ## the documentation as a site, build/site/index.html; a warning is an error
	[ -f build/docs/egg/summary.html ] || $(BIN)/mjtactile grasp --frames none --out build/docs/egg
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

# The tests have two tiers. The first checks what users do, in about five minutes. The second has the tests marked `slow`: they
# take more than about 3 s of a processor or of waiting, and a quicker test detects a complete failure. Tests marked `clock`
# use emulated devices and mostly wait: more of them run at a time than there are processors. No other computation may run at
# the same time, not even at the lowest priority, since valves would answer late. Few tests of the first tier compute, so that
# eight run at a time; seven whole rigs use most of both processors. A browser without a graphics card needs two processors.
# Each worker reads all given files. Only those that contain the mark are given, and the first tier omits files that are slow
# or clock as a whole (`pytestmark`), since the import of MuJoCo Warp takes 3 s. There one worker runs all tests of a file, so
# that the fixtures of a file are made once.
FIRST = -n 2 --dist loadfile -m 'not slow and not clock and not browser' $(wholly)
FIRST_CLOCK = -n 8 --dist loadgroup -m 'clock and not slow and not browser' $(call marked,clock)
SECOND = -n 2 --dist loadgroup -m 'slow and not clock and not browser' $(call marked,slow)
SECOND_CLOCK = -n 7 --dist loadgroup -m 'slow and clock and not browser' $(filter $(call marked,slow),$(call marked,clock))
wholly = $(addprefix --ignore=,$(shell grep -rlE '^pytestmark = \[?pytest\.mark\.(slow|clock)' --include='test_*.py' tests | sort))
marked = $(shell grep -rl --include='test_*.py' 'pytest\.mark\.$(1)' tests | sort)

test: first  ## lint, import contracts, and the tests of what users do (about 5 minutes)
	$(BIN)/pytest $(FIRST_CLOCK)
	$(BIN)/pytest -n 0 tests/browser

test-all: test slow  ## all that CI runs: `make test`, then types and the other tests (below 10 minutes)

# Types run at the same time as the tests: pyright uses one processor while it starts, pytest while it collects. A second
# thread of pyright would read most files again, which takes a quarter more of a processor's time. Types take a fifth of the
# time of the first tier and do not show that a command fails, so they are in the second.
slow: $(VENV)/.test-ready  ## what `make test` leaves out: types, long tests, and whole rigs of emulated hardware
	$(PYRIGHT) & types=$$!; $(BIN)/pytest $(SECOND) || { kill $$types; exit 1; }; wait $$types
	$(BIN)/pytest $(SECOND_CLOCK)

# Lint and contracts run at the same time: each uses one processor.
first: $(VENV)/.test-ready
	$(MAKE) --no-print-directory -j2 lint contracts
	$(BIN)/pytest $(FIRST)

lint: $(VENV)/.test-ready  ## style and likely bugs (ruff), and the language (tools/check_prose.py)
	$(BIN)/ruff check .
	$(BIN)/python tools/check_prose.py
	$(BIN)/ruff format --check --quiet . || { $(BIN)/ruff format --diff . | head -50; exit 1; }

types: $(VENV)/.test-ready  ## types (pyright)
	$(PYRIGHT) --threads 2

contracts: $(VENV)/.test-ready  ## who may import whom (import-linter)
	$(BIN)/lint-imports --no-cache

pytest: $(VENV)/.test-ready  ## some tests (ARGS="-k name" and so on), of both tiers; none in a browser
	$(BIN)/pytest -n 2 -m 'not browser' $(ARGS)

sanitize: $(VENV)/.test-ready  ## the kernels' tests, and chains with settings drawn at random, under gcc's address and undefined sanitizers
	$(BIN)/python -m tests.sanitized $(ARGS)

venv: $(VENV)/.test-ready  ## the virtual environment with everything, for development

# Steps, each repeated when its inputs change: an empty environment, packages of a run, packages of the tests.
$(VENV)/bin/python:
	@[ -n "$(PYTHON)" ] || { echo "make: no Python 3.11 or newer found; set PYTHON=/path/to/python" >&2; exit 2; }
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 \
	|| { rm -rf $(VENV); $(PYTHON) -m venv --without-pip $(VENV) && $(PYTHON) -m pip --quiet --python $(BIN)/python install pip; } \
	|| { rm -rf $(VENV); echo "make: $(PYTHON) cannot make a virtual environment: it lacks both ensurepip and pip" \
	     "(on Debian and Ubuntu: apt install python3-venv)" >&2; exit 2; }

$(VENV)/.run-ready: requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "make: installing mjtactile and its locked dependencies into $(VENV)"
	@$(INSTALL) -r requirements.lock
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

# Both are unpacked at the same time: each uses one processor. The last step adds what only another platform or Python needs.
$(VENV)/.test-ready: requirements-dev.lock requirements.lock pyproject.toml | $(VENV)/bin/python
	@$(MAKE) --no-print-directory -j2 $(VENV)/.run-ready $(VENV)/.tools-ready
	@$(INSTALL) -r requirements-dev.lock
	@touch $@

$(VENV)/.tools-ready: requirements-dev.lock | $(VENV)/bin/python
	@echo "make: installing the locked test tools into $(VENV)"
	@grep -v '^-r ' requirements-dev.lock | $(INSTALL) --no-deps -r /dev/stdin
	@touch $@

$(VENV)/.docs-ready: requirements-docs.lock $(VENV)/.test-ready
	@echo "make: installing the locked tools of the documentation into $(VENV)"
	@$(INSTALL) -r requirements-docs.lock
	@touch $@

wheels: $(VENV)/.test-ready  ## dist/: a wheel for each platform (they are all made here) and the source distribution
	rm -rf dist && $(BIN)/hatchling build -t sdist
	for platform in linux-x86_64 linux-aarch64 darwin-arm64 darwin-x86_64; do \
	    MJTACTILE_WHEEL=$$platform $(BIN)/hatchling build -t wheel || exit 1; done

lock:  ## renew requirements*.lock from pyproject.toml (newest versions that fit)
	rm -rf build/lock && $(PYTHON) -m venv build/lock
	build/lock/bin/pip --quiet install 'hatchling>=1.27' 'ziglang>=0.15' --editable '.[plots]'
	build/lock/bin/pip freeze --exclude-editable --exclude pip --exclude setuptools > build/run.txt
	build/lock/bin/pip --quiet install --editable '.[plots,dev]'
	build/lock/bin/pip freeze --exclude-editable --exclude pip --exclude setuptools > build/all.txt
	build/lock/bin/pip --quiet install --editable '.[plots,dev,docs]'
	build/lock/bin/pip freeze --exclude-editable --exclude pip --exclude setuptools > build/docs.txt
	(echo '# What a run needs. Made by `make lock`; do not edit.'; cat build/run.txt) > requirements.lock
	(echo '# What `make test` needs on top. Made by `make lock`; do not edit.'; \
	 echo '-r requirements.lock'; grep -vxFf build/run.txt build/all.txt) > requirements-dev.lock
	(echo '# What `make docs` needs on top of requirements-dev.lock. Made by `make lock`; do not edit.'; \
	 grep -vxFf build/all.txt build/docs.txt) > requirements-docs.lock

clean:  ## remove the environment, caches and build leftovers (results in runs/ stay)
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
