# Two commands do everything on a machine that has Python 3.11 or newer with pip, and make:
#   make demo    install into .venv, build the FMUs, co-simulate the work cycle, validate, write a report
#   make test    the tests
# On Windows, without make: see "Windows" in README.md.

PYTHON ?= python3
BIN := .venv/bin
# empty files: what is installed in .venv
INSTALLED := .venv/.have-build
EVERYTHING := .venv/.have-all
TESTING := .venv/.have-test
PEERS := .venv/.have-peers
DOCUMENTING := .venv/.have-docs
RELEASING := .venv/.have-release

# With stored byte code every command starts 0.3 to 4 s sooner; the tests start hundreds of commands.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-long test-search lint matrix bench bench-sensitivities bench-indices bench-sweep bench-peers bench-live coverage mutants \
  docs pages clean release constraints extras test-lowest test-newest audit

# with all extras, for the commands in README.md. FMI 2.0, and the whole machine in FMI 3.0, which the report
# shows; `harvester build` makes the rest
demo: $(EVERYTHING)
	$(BIN)/harvester build --fmi 2
	$(BIN)/harvester build --fmi 3 --only harvester
	$(BIN)/harvester validate

# PART=1/3: those of three parts of the tests that has the number 1; FIRST and UNTIL: see .ci/run
WORKERS := 2
PYTEST = $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal $(PART:%=--part=%) $(FIRST:%=--first=%) $(UNTIL:%=--until=%)

# fails also if a file takes more than its share (tests/kit/shares.py)
test: $(TESTING)
	$(PYTEST) --seconds

# the long tests, in shards (tests/kit/shards.py): all of them, or `make test-browser`, `make test-c`
test-long: test-documents test-fresh test-tools test-platforms test-c test-browser test-faults test-machine test-targets test-search

# other examples in each run; with SEED=1 the same
test-search: $(TESTING)
	$(PYTEST) -m "long(shard='search') or hypothesis" --hypothesis-profile=search $(SEED:%=--hypothesis-seed=%)

# a clone is installed, built and tried in one test
test-fresh test-targets: PYTEST += -o faulthandler_timeout=7000
test-%: $(TESTING)
	$(PYTEST) -m "long(shard='$*')"

lint: $(TESTING)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# ARGS: options of the benchmark, such as make bench-peers ARGS="--repeats 1"
bench: $(EVERYTHING)
	test -f build/harvester.ssp || $(BIN)/harvester build
	$(BIN)/python -m benchmarks.costs $(ARGS)
	$(BIN)/python -m benchmarks.speed $(ARGS)
	$(BIN)/python -m benchmarks.variants

bench-sensitivities: $(EVERYTHING)
	$(BIN)/python -m benchmarks.sensitivities
	$(BIN)/python -m benchmarks.starts

# sensitivity indices of a million runs
bench-indices: $(EVERYTHING)
	$(BIN)/python -m benchmarks.indices $(ARGS)

bench-live: $(TESTING)
	test -f build/harvester.ssp || $(BIN)/harvester build
	$(BIN)/python -m benchmarks.live --browser $(ARGS)

bench-sweep: $(EVERYTHING)
	test -f build/harvester.ssp || $(BIN)/harvester build
	$(BIN)/python -m benchmarks.sweep $(ARGS)

# every FMU and SSP in every tool that is found; writes the tables of docs/other-tools.md
matrix: $(TESTING)
	$(BIN)/harvester build
	$(BIN)/python -m benchmarks.matrix $(ARGS)

bench-peers: $(PEERS)
	$(BIN)/python -m benchmarks.peers $(ARGS)
	$(BIN)/python -m benchmarks.peers.many $(ARGS)

# a sample of changed operators and numbers, and whether the tests near them notice; two hours
mutants: $(TESTING)
	$(BIN)/python -m benchmarks.mutants run

coverage: $(EVERYTHING)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.coverage $(ARGS)

# the site, as build/site/index.html; its home page has the machine
PARTS := swing boom_stick manipulator supply operator_input
docs: $(DOCUMENTING)
	test -f build/harvester.ssp || $(BIN)/harvester build --fmi 2 $(PARTS:%=--only %)
	test -f build/fmi3/harvester.fmu || $(BIN)/harvester build --fmi 3 --only harvester
	$(BIN)/sphinx-build -q -W --keep-going -c docs . build/site

# figures, tables and numbers that the pages take from computations; then see what has changed
pages: $(TESTING)
	for page in circuits icons opening_curve pump_efficiency pictures crane_keys machine counterbalance rate_ports convergence identification fidelity; do \
	  echo "docs/$$page.py"; $(BIN)/python docs/$$page.py || exit 1; done

clean:
	rm -rf build .venv

# wheel, sdist, and a zip of FMUs and their documentation, in dist/; two runs give the same bytes. For a try on
# this computer: make release PLATFORMS=host
release: $(RELEASING)
	$(BIN)/python tools/release.py $(PLATFORMS)

# writes constraints.txt anew: the newest versions that pyproject.toml allows, for all platforms and extras; and
# lock.txt, the same with hashes
constraints: $(RELEASING)
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --all-extras --no-emit-package harvester-cosim \
	  --no-annotate --no-header --upgrade pyproject.toml -o constraints.txt
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --all-extras --no-emit-package harvester-cosim \
	  --no-annotate --no-header --generate-hashes -c constraints.txt pyproject.toml -o lock.txt

# the table of extras in README.md, with sizes on this computer
extras: $(RELEASING)
	$(BIN)/python tools/extras.py

# the lowest and the newest versions that pyproject.toml allows, each in an environment of its own; a fast part
# of the tests. With old versions warnings are no errors
FAST := tests/cli/test_extras.py tests/cli/test_cli.py tests/cli/test_validate.py tests/orchestrator/test_cli.py \
  tests/orchestrator/test_run.py tests/orchestrator/test_matlab.py tests/validation tests/check/test_good.py tests/sweep/test_running.py \
  tests/sweep/test_analysis_sobol.py tests/identification/procedures tests/view/test_page_command.py \
  tests/control/test_linear_use.py tests/python_fmu/test_user_file.py

test-lowest: $(RELEASING)
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/lowest
	$(BIN)/uv pip install --quiet --python build/lowest --resolution lowest-direct -e ".[all]"
	$(BIN)/uv pip install --quiet --python build/lowest -e . $(TESTS_NEED)
	build/lowest/bin/python -m pytest -W default $(FAST)

test-newest: $(RELEASING)
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/newest
	$(BIN)/uv pip install --quiet --python build/newest -e ".[all]" $(TESTS_NEED)
	build/newest/bin/python -m pytest $(FAST)

TESTS_NEED := pytest pytest-timeout pytest-xdist hypothesis httpx playwright

# Licences of the installed packages, and known vulnerabilities of the versions in lock.txt; the latter
# asks a database on the internet. Read by hand: casadi, asammdf and npTDMS LGPL-3.0 (libraries that are imported, unchanged),
# docutils public domain with a few GPL files (of Sphinx, not loaded); without a declaration FMPy BSD-2-Clause,
# cmeel-qhull Qhull, objective-rating-metrics MIT, axe-playwright-python MIT (of tests)
PERMISSIVE := MIT;BSD;Apache;ISC;MPL;Mozilla;PSF;Python Software Foundation;Zlib;BSL;Unlicense;CC0
audit: $(RELEASING) $(TESTING)
	$(BIN)/pip-licenses --from=mixed --partial-match --allow-only="$(PERMISSIVE)" --order=license --format=markdown \
	  --ignore-packages harvester-cosim asammdf casadi docutils fmpy cmeel-qhull nptdms objective-rating-metrics axe-playwright-python
	$(BIN)/pip-audit --requirement lock.txt --require-hashes --disable-pip

# a second call skips the installation; constraints.txt has the versions that were tested
$(INSTALLED): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python tools/install.py build
	touch $@

$(EVERYTHING): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python tools/install.py all
	touch $@

$(TESTING): $(INSTALLED)
	$(BIN)/python tools/install.py test
	touch $@

$(PEERS): $(INSTALLED)
	$(BIN)/python tools/install.py build reference peers
	touch $@

$(DOCUMENTING): $(INSTALLED)
	$(BIN)/python tools/install.py docs
	touch $@

$(RELEASING): $(INSTALLED)
	$(BIN)/python tools/install.py release
	touch $@
