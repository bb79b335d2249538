# Two commands do everything, set-up included: `make demo` and `make test`.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUNTIME_VENV := .venv-runtime
STAMP := $(VENV)/.installed
OUT ?= demo

.PHONY: help setup demo test slow docs check clean

help:
	@echo "make setup   make $(VENV) with both packages"
	@echo "make demo    a simulated sweep, end to end, into $(OUT)/"
	@echo "make test    every test but the slow campaigns"
	@echo "make slow    the slow campaigns"
	@echo "make docs    the site, into site/"
	@echo "make check   lint, type-check, import rules, and the runtime's wheel alone, under several Pythons"

setup: $(STAMP)

$(STAMP): pyproject.toml runtime/pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "error: $(PYTHON) not found; install it: apt-get install python3 python3-venv" >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: $$($(PYTHON) --version) found, Python 3.11 or newer expected; set PYTHON=python3.x" >&2; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "error: Python's venv is missing; install it: apt-get install python3-venv" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ./runtime --editable '.[dev]'
	@touch $(STAMP)
	@echo "next: . $(BIN)/activate   # then legtool --help"

demo: $(STAMP)
	$(BIN)/legtool demo --out $(OUT)
	@echo "legtool is installed into $(VENV): . $(BIN)/activate"

test: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 -m "not slow"

slow: $(STAMP)
	$(BIN)/python -m pytest -m slow

docs: $(STAMP)
	$(BIN)/sphinx-build --fail-on-warning --jobs auto -b html docs site
	@echo "open site/index.html"

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	rm -rf $(RUNTIME_VENV) dist
	$(BIN)/python -m build --outdir dist runtime
	$(BIN)/python -m build --outdir dist .
	$(BIN)/twine check --strict dist/*
	$(PYTHON) -m venv $(RUNTIME_VENV)
	$(RUNTIME_VENV)/bin/python -m pip install --quiet dist/legtool_runtime-*.whl pytest pytest-xdist hypothesis
	$(RUNTIME_VENV)/bin/python -I -c 'import importlib.util as u; assert u.find_spec("torch") is None and u.find_spec("legtool") is None'
	cd runtime/tests && OMP_NUM_THREADS=1 ../../$(RUNTIME_VENV)/bin/python -m pytest -c /dev/null -o markers=slow --rootdir . --import-mode=importlib -n 2 -m "not slow" .
	.ci/pythons

clean:
	rm -rf $(VENV) $(RUNTIME_VENV) dist build site docs/generated .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
