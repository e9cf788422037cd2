# Two commands do everything on a machine that has Python 3.11 or newer with pip, and make:
#   make demo    install into .venv, build the FMUs, co-simulate the work cycle, validate, write a report
#   make test    the tests
# On Windows, without make: see "Windows" in README.md.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed
TESTING := .venv/testing
PEERS := .venv/peers
DOCUMENTING := .venv/documenting

.PHONY: demo test test-long lint matrix bench bench-sensitivities bench-sweep bench-peers bench-live coverage docs clean

demo: $(INSTALLED)
	$(BIN)/harvester build
	$(BIN)/harvester validate

test: $(TESTING)
	$(BIN)/python -m pytest -n 2 --dist worksteal

test-long: $(TESTING)
	$(BIN)/python -m pytest -n 2 -m long -s
	$(BIN)/python -m pytest -n 2 -m hypothesis --hypothesis-profile=search

lint: $(TESTING)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(INSTALLED)
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.variants

bench-sensitivities: $(INSTALLED)
	$(BIN)/python -m benchmarks.sensitivities
	$(BIN)/python -m benchmarks.starts

bench-live: $(TESTING)
	$(BIN)/python -m benchmarks.live --browser

bench-sweep: $(INSTALLED)
	test -f build/harvester.ssp || $(BIN)/harvester build
	$(BIN)/python -m benchmarks.sweep

# every FMU and SSP in every tool that is found; writes the tables of docs/other-tools.md
matrix: $(TESTING)
	$(BIN)/harvester build
	$(BIN)/python -m benchmarks.matrix

bench-peers: $(PEERS)
	$(BIN)/python -m benchmarks.peers

coverage: $(INSTALLED)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.coverage

# the site, as build/site/index.html
docs: $(DOCUMENTING)
	$(BIN)/sphinx-build -q -W --keep-going -c docs . build/site

clean:
	rm -rf build .venv

# the stamps make a second call skip the installation
$(INSTALLED): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

$(TESTING): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[test]"
	touch $@

$(PEERS): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[peers]"
	touch $@

$(DOCUMENTING): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[docs]"
	touch $@
