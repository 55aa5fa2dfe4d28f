# Two commands do everything on a machine that has Python 3.11+ and make:
#   make demo   the whole job on the simulated bench
#   make test   style, types, floors and all tests
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed-from
WANTED := $(shell cat requirements.lock pyproject.toml 2>/dev/null | cksum)

.PHONY: demo test check types style floors secrets ui lock clean $(VENV)

demo: $(VENV)
	$(BIN)/goniometer demo

# Four workers keep two cores busy, for tests of devices that do not answer wait in real time.
test: $(VENV)
	@$(MAKE) --no-print-directory -j 2 check
	$(BIN)/python -m pytest -n 4 --dist loadfile --no-loadscope-reorder

# Goals of their own, so that two cores can share them.
check: style types floors secrets

style: $(VENV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)
	$(BIN)/mypy

floors: $(VENV)
	$(BIN)/lint-imports

secrets: $(VENV)
	$(BIN)/bandit -q -c pyproject.toml -r drivers goniometer analysis simulators api

# Builds the pages of the service into api/static; only who changes them needs Node.
ui: $(VENV)
	$(BIN)/python -m api.web.openapi > api/ui/openapi.json
	cd api/ui && npm ci && npm run types && npm run check && npm run build

# The environment is rebuilt from nothing when the lock or pyproject.toml has changed, and left alone otherwise.
$(VENV):
	@if [ "$$(cat $(STAMP) 2>/dev/null)" != "$(WANTED)" ]; then set -e; \
	  echo "Setting up $(VENV) from requirements.lock (about two minutes the first time)"; \
	  $(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "goniometer needs Python 3.11 or newer, this is " + sys.version.split()[0] + "; say which to use with make PYTHON=python3.12 ...")'; \
	  rm -rf $(VENV); $(PYTHON) -m venv $(VENV); \
	  $(BIN)/python -m pip install --disable-pip-version-check --require-hashes -r requirements.lock; \
	  $(BIN)/python -m pip install --disable-pip-version-check --no-deps --no-build-isolation -e .; \
	  echo "$(WANTED)" > $(STAMP); \
	fi

# Writes the lock anew from pyproject.toml; it names packages, versions and hashes, never an address.
lock: $(VENV)
	$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes --extra dev \
	  --no-header --no-annotate --output-file requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) demo
