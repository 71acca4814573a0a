# Everything from a bare machine with python3 >= 3.11 and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2
MAP ?=
VIEW ?=
PART ?=
REPOSITORY ?=

SEED ?= 1
TESTS ?= tests

.PHONY: demo test bench docs lint types layers check clean warmup wheel audit bounds shuffle oldest

# The demo needs a part of what tests, lint and the documentation need, and of that few modules: Python compiles these
# when they are imported, which is two fifths of the time of installing less.
NEEDS_demo := --no-compile -e ".[demo]"
NEEDS_all := -e ".[all]" --group test --group lint --group docs

# A stamp is newer than the project file and the constraints when what it names is installed. Those
# are of the Python that is tested; on others pip chooses within the ranges of the project file.
$(VENV)/.installed-%: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "python3 >= 3.11 is needed, found " + sys.version.split()[0] + "; try: make PYTHON=python3.12")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(if $(findstring --group,$(NEEDS_$*)),$(BIN)/python -m pip install -q --upgrade "pip>=25.1")
	@if $(BIN)/python -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'; \
	then pinned="-c constraints.txt"; \
	else echo "constraints.txt is for Python 3.11: pip chooses the newest versions that pyproject.toml allows"; \
	fi; \
	$(BIN)/python -m pip install -q $$pinned $(NEEDS_$*)
	@touch $@

# Kernels of its first chapters; those of the others are compiled during these.
FIRST_CHAPTERS := navigation.mapping navigation.grid navigation.planning navigation.pushing sensing tracking \
	simulation.foam simulation.mobile simulation.rendering

demo: export PYTHONDONTWRITEBYTECODE :=
demo: $(VENV)/.installed-demo ## Run the end-to-end demo
	$(if $(PART)$(MAP),,$(BIN)/visuohaptic warmup $(FIRST_CHAPTERS) --workers $(JOBS))
	$(BIN)/visuohaptic demo $(PART) $(if $(MAP),--map $(MAP)) $(if $(VIEW),--view)

# Each worker has one core: the threads of its libraries would compete for the others. Bytecode is kept: otherwise each worker
# and each process that a test starts compiles the library again.
test: $(VENV)/.installed-all ## Run all tests
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal

# Files of tests, and tests in each of them, in a random order: a test must not need another one.
shuffle: $(VENV)/.installed-all ## Run tests in a random order (SEED=1 TESTS=tests)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q --shuffle $(SEED) $(TESTS)

# Kernels are compiled again, into folders of their own, since their code differs; tests of that code itself are left out.
CODE_TESTS := tests/core/test_kernel_cost.py tests/core/test_shipped_kernels.py tests/core/test_kernel_callees.py \
	tests/core/test_kernel_compiler.py tests/core/test_kernel_files.py tests/core/test_cache.py tests/cli/test_warmup.py
bounds: $(VENV)/.installed-all ## Run tests with every index of every kernel checked (TESTS=tests)
	NUMBA_BOUNDSCHECK=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal \
		$(addprefix --ignore=,$(CODE_TESTS)) $(TESTS)

# The lowest versions that the project file allows, in an environment of their own; constraints.txt pins the other end of
# the ranges. These tests use every one of them, and compile few kernels.
OLDEST := $(VENV)-oldest
OLDEST_TESTS := tests/test_front_door.py tests/test_golden.py tests/core/test_camera.py tests/core/test_codec.py \
	tests/core/test_geometry.py tests/database/test_sync_machine.py tests/deformation/test_shell.py \
	tests/io/test_mcap.py tests/io/test_mesh.py tests/io/test_sqlite_bag.py tests/io/test_tables.py \
	tests/navigation/test_edit_machine.py tests/navigation/test_map_machines.py tests/recognition/test_tree.py \
	tests/report tests/ros/test_cdr.py tests/viewer
oldest: ## Run a part of the tests with the lowest versions of all dependencies
	test -x $(OLDEST)/bin/python || $(PYTHON) -m venv $(OLDEST)
	$(OLDEST)/bin/python -m pip install -q uv
	$(OLDEST)/bin/uv pip install -q --python $(OLDEST)/bin/python --resolution lowest-direct -e ".[all]" --group test
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(OLDEST)/bin/python -m pytest -m "not slow and not data" $(OLDEST_TESTS)

audit: $(VENV)/.installed-all ## List all dependencies (CycloneDX) and their known vulnerabilities
	-$(BIN)/python -m pip install -q pip-audit
	$(BIN)/python -m benchmarks.audit --out dist/sbom.json

bench: $(VENV)/.installed-all ## Run every benchmark, each as a ratio to a named peer
	$(BIN)/python -m benchmarks

docs: $(VENV)/.installed-all ## Build the documentation in site/, without warnings
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

lint: $(VENV)/.installed-all
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-all
	$(BIN)/mypy

layers: $(VENV)/.installed-all
	$(BIN)/lint-imports

warmup: $(VENV)/.installed-all
	$(BIN)/visuohaptic warmup --workers $(JOBS)

wheel: $(VENV)/.installed-all ## Build the wheels of a release in dist/: the library, and its compiled kernels
	$(if $(REPOSITORY),,@echo "no REPOSITORY=https://HOST/OWNER/REPOSITORY: the links of the README stay relative, for a local wheel only")
	VISUOHAPTIC_REPOSITORY=$(REPOSITORY) $(BIN)/python -m pip wheel -q --no-deps --wheel-dir dist .
	$(BIN)/python -m benchmarks.kernel_wheel --out dist --jobs $(JOBS)

check: lint types layers

clean:
	rm -rf $(VENV) $(OLDEST) site results .mypy_cache .ruff_cache .pytest_cache .hypothesis
