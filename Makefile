# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0

PYTHON ?= python3
PYTHON_FLOOR ?= python3.10
DISTRO ?= jazzy
VENV ?= .venv
# One more than two cores, because tests of nodes wait most of the time.
JOBS ?= 3
HOURS ?= 1
# Multiple of the inputs of test_fuzz.py that `make fuzz` tries.
TIMES ?= 20
# Extra of setup.py with filter libraries and another DDS, which only tests use; empty: none.
CONSUMERS ?= consumers
TESTS ?= test

PIP_OPTIONS := --quiet --no-compile --prefer-binary --disable-pip-version-check
FLOOR := .venv-floor
LINT := .venv-lint
SITE := .venv-site
# The type checker and the numpy whose types it reads are pinned, so that the result does not
# depend on the Python or the numpy of the environment that runs the tests.
LINT_PINS := mypy==2.4.1 ruff==0.17.5
LINT_TYPES := numpy==2.4.6 rich==15.0.0 hypothesis==6.170.15
# No test runs all benchmarks and scripts: names and arguments that do not exist must be found without.
SCRIPT_TYPES := --config-file= --python-version 3.11 --ignore-missing-imports --follow-imports silent \
	--check-untyped-defs --disable-error-code arg-type --disable-error-code index --disable-error-code union-attr
# What Ubuntu 22.04 (ROS 2 Humble) ships.
FLOOR_PINS := numpy==1.21.* scipy==1.8.* matplotlib==3.5.*

# The ROS wheels re-execute Python and set a marker, which a child in another venv must not inherit.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif

# pip installs without compiling; Python compiles modules at their first import and must save this.
unexport PYTHONDONTWRITEBYTECODE

# The matrices of a fit are small: more threads per process only cost time.
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help venv demo test unit golden golden-check test-pythons test-floor site lint format bench fuzz audit docs \
	pictures clean

help:  ## show this help
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' Makefile
	@echo '  (VENV=$(VENV) DISTRO=$(DISTRO) PYTHON=$(PYTHON) JOBS=$(JOBS) can be given)'

venv: $(VENV)/.tested  ## create the environment, with rclpy wheels where they exist

demo: $(VENV)/.ready  ## simulate the IMU of a paper (HOURS=1), analyze it, compare with the truth
	$(VENV)/bin/python scripts/demo.py demo --hours $(HOURS)

test: unit lint  ## run all tests, then check style and types

unit: $(VENV)/.tested  ## run the tests alone (TESTS=test/core for some of them)
	AMENT_PREFIX_PATH="$(abspath $(VENV)):$$AMENT_PREFIX_PATH" \
		$(VENV)/bin/python -m pytest -q -n $(JOBS) --dist loadfile $(TESTS)

golden: $(VENV)/.tested  ## store every number of several recordings, and list what changed
	PYTHONPATH=.:test $(VENV)/bin/python -m golden.harness
	STORE_GOLDEN=1 $(VENV)/bin/python -m pytest -q test/export/test_targets.py -k word_for_word

golden-check: $(VENV)/.tested  ## compare every number of several recordings with the stored ones
	PYTHONPATH=.:test $(VENV)/bin/python -m golden.harness --check

lint: $(LINT)/.ready  ## check style and types
	$(LINT)/bin/ruff check .
	$(LINT)/bin/ruff format --check .
	$(LINT)/bin/mypy
	$(LINT)/bin/mypy $(SCRIPT_TYPES) bench scripts

format: $(LINT)/.ready  ## format the code and fix what ruff can fix
	$(LINT)/bin/ruff check --fix .
	$(LINT)/bin/ruff format .

bench: $(VENV)/.tested  ## run the benchmarks
	@for file in $(wildcard bench/bench_*.py); do echo "== $$file"; $(VENV)/bin/python $$file || exit 1; done

fuzz: $(VENV)/.tested  ## try damaged inputs of every kind: no crash, no silent loss
	ALLAN_ROS_FUZZ=$(TIMES) $(VENV)/bin/python -m pytest -q -o faulthandler_timeout=600 test/test_fuzz.py

audit: $(VENV)/.tested  ## list what is installed with its licenses, ask PyPI for vulnerabilities
	$(VENV)/bin/python -m pip install $(PIP_OPTIONS) --editable '.[audit]'
	$(VENV)/bin/python scripts/audit.py

docs: $(VENV)/.tested  ## write the pages of docs/ that come from the code
	$(VENV)/bin/python scripts/reference.py
	$(VENV)/bin/python scripts/sensor_table.py
	$(VENV)/bin/python scripts/quoted_output.py

site: $(SITE)/.ready  ## build the documentation as a website, into site/
	NO_MKDOCS_2_WARNING=1 $(SITE)/bin/mkdocs build --quiet --strict

pictures: $(VENV)/.tested  ## redraw the pictures of docs/
	$(VENV)/bin/python scripts/pictures.py docs/images
	$(VENV)/bin/python scripts/report_pictures.py docs/images

test-pythons:  ## run all tests on every installed CPython from 3.10 to 3.14
	@scripts/pythons.sh | while read -r version python; do \
		echo "== Python $$version"; \
		$(MAKE) test PYTHON=$$python VENV=.venv-$$version </dev/null || exit 1; done

test-floor: $(FLOOR)/.ready  ## run the tests that need no ROS on the oldest numpy and scipy
	$(FLOOR)/bin/python -m pytest -q -n $(JOBS) --dist loadfile test/core test/readers test/results test/export test/view test/cli

clean:  ## remove environments and what was built
	rm -rf $(VENV) .venv .venv-* build site install log demo *.egg-info

# The stamp is written last: an unfinished environment, or one whose Python is gone, is recreated.
define runs
ifneq ($$(shell $(1)/bin/python -c 'print("runs")' 2>/dev/null),runs)
.PHONY: $(1)/.ready
endif
endef
$(foreach each,$(VENV) $(LINT) $(SITE),$(eval $(call runs,$(each))))

# An environment that the user has created is kept if its pip runs.
$(VENV)/.ready: setup.py pyproject.toml scripts/venv_extras.py
	$(VENV)/bin/python -m pip --version >/dev/null 2>&1 || { rm -rf $(VENV) && $(PYTHON) -m venv $(VENV); }
	extras=$$($(VENV)/bin/python scripts/venv_extras.py $(DISTRO)) && \
		$(VENV)/bin/python -m pip install $(PIP_OPTIONS) --editable ".$${extras:+[$$extras]}"
	touch $@

# What only tests and benchmarks need is added to it.
$(VENV)/.tested: $(VENV)/.ready
	extras=$$($(VENV)/bin/python scripts/venv_extras.py $(DISTRO) $(CONSUMERS) 2>/dev/null) && \
		$(VENV)/bin/python -m pip install $(PIP_OPTIONS) --editable ".[test$${extras:+,$$extras}]"
	touch $@

# Of these packages only the type annotations are read, so they may need a newer Python.
$(LINT)/.ready: Makefile
	rm -rf $(LINT)
	$(PYTHON) -m venv $(LINT)
	$(LINT)/bin/python -m pip install $(PIP_OPTIONS) $(LINT_PINS)
	packages=$$($(LINT)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') && \
		$(LINT)/bin/python -m pip install $(PIP_OPTIONS) --target "$$packages" --no-deps \
		--ignore-requires-python --only-binary=:all: --python-version 3.11 $(LINT_TYPES)
	touch $@

$(SITE)/.ready: Makefile
	rm -rf $(SITE)
	$(PYTHON) -m venv $(SITE)
	$(SITE)/bin/python -m pip install $(PIP_OPTIONS) 'mkdocs-material>=9.5,<10'
	touch $@

$(FLOOR)/.ready: setup.py pyproject.toml
	rm -rf $(FLOOR)
	$(PYTHON_FLOOR) -m venv $(FLOOR)
	$(FLOOR)/bin/python -m pip install $(PIP_OPTIONS) --editable '.[test]' $(FLOOR_PINS)
	touch $@
