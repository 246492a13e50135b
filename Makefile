# make help lists the targets.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
MAKEFLAGS += --no-builtin-rules

BIN := .venv/bin
comma := ,
space := $(subst ,, )
VIEW := build/typing/alula
NATIVE := $(shell find native -name '*.[ch]' -o -name '*.[ch]pp') CMakeLists.txt
LOCKED := $(BIN)/pip install -q --disable-pip-version-check --no-compile --require-hashes

NATIVE_TESTS := $(basename $(notdir $(wildcard native/*/tests/*_test.cpp)))
# Those that start no thread (`strace -f -e clone3`): not built and run with the thread sanitizer.
UNTHREADED := crazyflie_obstacles dr_acbf geofence links map minimum_time moving_world plant polytope_cbf \
  polytope_image polytope_map qp rates stack stack_flight teensy teensy_flight teensy_velocity tiles tracker wall_planes \
  wrench_filters

# Smoke tests of the wheel: every command once, its artifacts, streams and exit codes.
WHEEL_TESTS := tests/command/program/test_conduct.py tests/command/results/test_info.py tests/unit/schemas/test_artifact.py

# Compilers are called through ccache where it is installed.
ifneq ($(shell command -v ccache),)
export CMAKE_C_COMPILER_LAUNCHER := ccache
export CMAKE_CXX_COMPILER_LAUNCHER := ccache
endif

# Without its compiled modules every program that tests start, and every worker, compiles them anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-all setup firmware lint format typecheck typing-view test-native native-address native-thread native-fuzz onboard fuzz attack test-wheel test-core wheel wheels examples papers bench bench-installation bench-compression bench-formats bench-filters bench-dracbf bench-onboard bench-betaflight bench-alignment bench-fly bench-autopilots bench-faults bench-plan bench-world bench-pages docs man schemas lock clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1\t\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 20

demo: ## install what the main job needs, fly the built-in scene end to end and leave a report
	@$(MAKE) --no-print-directory --quiet -j2 .venv/.demo .venv/.installed
	@$(MAKE) --no-print-directory -j2 --output-sync -C examples/room

test: setup ## install what the tests need and run them, all but long and real-time ones: minutes
	$(BIN)/pytest tests -n auto --dist worksteal -m "not slow and not realtime"

test-all: setup ## run all tests: flights in real time, two at once, then all others, with new random examples
	ALULA_TESTS=all $(BIN)/pytest tests -n 2 --dist worksteal -m realtime
	ALULA_TESTS=all $(BIN)/pytest tests -n auto --dist worksteal -m "not realtime"

setup: ## make the environment in .venv/
	@$(MAKE) --no-print-directory --quiet -j2 .venv/.dependencies .venv/.installed

.venv/bin/pip:
	.ci/system-packages "$$(.ci/find-python)"
	@echo "making .venv, with what compiles the native code"
	@.ci/make-venv "$$(.ci/find-python)"

# The two are installed side by side: no package is in both.
.venv/.native: .ci/native.lock | $(BIN)/pip
	@$(LOCKED) -r .ci/native.lock
	@touch $@

.venv/.view: .ci/demo.lock | $(BIN)/pip
	@echo "installing the packages of the pipeline and of its pictures"
	@$(LOCKED) --no-deps -r .ci/demo.lock
	@touch $@

.venv/.demo: .venv/.view | .venv/.native
	@$(BIN)/python -c 'import matplotlib.pyplot, scipy.optimize, scipy.spatial, trimesh, viser' # compiles these, lists fonts
	@touch $@

.venv/.dependencies: .ci/requirements.lock .ci/peers.lock | .venv/.demo
	.ci/system-packages --libraries
	@echo "installing all extras and what the tests need: 2 GB"
	@.ci/install .ci/requirements.lock .ci/peers.lock
	@touch $@

.venv/.installed: pyproject.toml $(NATIVE) native/python/alula/__init__.py | .venv/.native
	@echo "compiling the native code on $$(nproc) processors, a minute or two"
	@$(BIN)/pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@
	@echo "compiled"

firmware: .venv/.firmware ## compile Betaflight's firmware for the flights through it (GPL), half a minute

.venv/.firmware: .venv/.dependencies .ci/firmware-build.lock .ci/firmware.lock
	$(LOCKED) -r .ci/firmware-build.lock
	MAKEFLAGS=-j$$(nproc) $(LOCKED) --no-deps --no-build-isolation -r .ci/firmware.lock
	touch $@

format: setup ## format all sources
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	@$(BIN)/clang-format -i $(filter-out CMakeLists.txt,$(NATIVE))

lint: setup ## check style and formatting
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/shellcheck $$(grep -lE '^#!.*sh$$' .ci/*)
	@$(BIN)/clang-format --dry-run -Werror $(filter-out CMakeLists.txt,$(NATIVE))

typing-view: setup ## link the sources under one namespace for static tools
	@mkdir -p $(VIEW)
	@for part in cli stages schemas; do ln -sfn $(CURDIR)/$$part $(VIEW)/$$part; done
	@for file in __init__.py py.typed _core.pyi; do ln -sfn $(CURDIR)/native/python/alula/$$file $(VIEW)/$$file; done

typecheck: typing-view ## check types, strictly
	$(BIN)/mypy -p alula -p papers

test-native: setup ## build the native tests with sanitizers and run them, and fuzz for 20 s where clang can
	@$(MAKE) --no-print-directory -j2 native-address native-fuzz

# $(call sanitized,sanitizers,folder,tests): two at a time, on all processors each, which the longer one takes over.
define sanitized
	@$(BIN)/cmake -S . -B build/$(2) -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja \
	  -DALULA_PYTHON=OFF -DALULA_TESTS=ON -DALULA_SANITIZE=$(1) >/dev/null
	@$(BIN)/cmake --build build/$(2) -j$$(nproc) --target $(3)
	@.ci/fixed-addresses $(BIN)/ctest --test-dir build/$(2) --output-on-failure -j$$(nproc) \
	  -R '^($(subst $(space),|,$(3)))$$'
endef

native-address:
	$(call sanitized,address$(comma)undefined,native-address,$(NATIVE_TESTS))

native-thread:
	$(call sanitized,thread,native-thread,$(filter-out $(UNTHREADED:%=%_test),$(NATIVE_TESTS)))

native-fuzz: native-thread # the shorter of the two
	.ci/fixed-addresses $(BIN)/python -P tests/support/fuzz/fuzz_onboard.py --seconds 20

onboard: setup ## run the filters on emulated microcontrollers: the host's bits, instructions, sizes, stacks
	.ci/system-packages --onboard
	$(BIN)/python -P benchmarks/onboard.py
	$(BIN)/python -P benchmarks/glue.py

fuzz: setup ## 20,000 mutated artifacts against every command; mutated splats, meshes and onboard inputs, for FUZZ_SECONDS=600 each
	$(BIN)/python -P tests/support/fuzz/fuzz_artifacts.py --most $(or $(FUZZ_MUTANTS),20000) --keep build/fuzz-artifacts
	$(BIN)/python -P tests/support/fuzz/fuzz_splats.py --seconds $(or $(FUZZ_SECONDS),600) --keep build/fuzz
	$(BIN)/python -P tests/support/fuzz/fuzz_meshes.py --seconds $(or $(FUZZ_SECONDS),600) --keep build/fuzz-meshes
	.ci/system-packages --fuzz
	$(BIN)/python -P tests/support/fuzz/fuzz_onboard.py --seconds $(or $(FUZZ_SECONDS),600)

attack: setup ## search for a false claim at random: an hour, a minute with QUICK=1; SEED=n draws other cases
	PYTHONPATH=tests nice $(BIN)/python -P -m support.attack --seconds $(if $(QUICK),55,3600) --seed $(or $(SEED),0)

# The wheel is built where the editable install was: what that compiled is compiled once.
wheel: setup ## build the wheel and the sdist into dist/
	rm -rf dist
	ALULA_COMMIT=$$(git describe --always --dirty --abbrev=12 --exclude='*' 2>/dev/null || true) \
	  $(BIN)/python -m build -q --no-isolation --sdist --wheel --outdir dist .
	@ls -l dist

wheels: .venv/.native ## wheels into dist/ of every CPython that a release has, as far as it is installed here
	rm -rf dist
	.ci/wheels

# Its environment has the wheel, and sees the packages (but not the editable install) of .venv.
test-wheel: wheel ## run smoke tests against the built wheel in an environment of its own
	$$($(BIN)/python -c 'import sys; print(sys._base_executable)') -m venv --clear build/wheel-venv
	$(BIN)/python -c 'import site; print(site.getsitepackages()[0])' \
	  > "$$(build/wheel-venv/bin/python -c 'import site; print(site.getsitepackages()[0])')/packages.pth"
	build/wheel-venv/bin/pip install -q --disable-pip-version-check --no-deps dist/*.whl
	build/wheel-venv/bin/python -P -c 'import alula._core; assert "wheel-venv" in alula._core.__file__'
	build/wheel-venv/bin/python -P -m pytest -m 'not slow' $(WHEEL_TESTS)

test-core: wheel ## install the wheel without extras, run the pipeline with it, and fail where it is too large
	$(BIN)/python -P benchmarks/installation.py dist/*.whl --core

bench-installation: wheel ## the same with every extra, some minutes, into docs/dependencies.md
	$(BIN)/python -P benchmarks/installation.py dist/*.whl --markdown docs/dependencies.md

examples: demo ## run every example
	@$(MAKE) --no-print-directory -C examples/polymerge

papers: setup ## every table, figure and number of the four papers beside ours, on one page: hours, minutes with QUICK=1; SCHEDULER=tcp://host:port flies elsewhere
	@$(MAKE) --no-print-directory -C examples/papers

bench: setup ## time the stages, and covers against those of other tools, side by side
	$(BIN)/python -P benchmarks/pipeline.py
	$(BIN)/python -P benchmarks/compression.py --quick

bench-compression: setup ## the latter in full, one to two hours, into docs/results/benchmarks.md
	$(BIN)/python -P benchmarks/compression.py --markdown docs/results/benchmarks.md

bench-formats: setup ## readers of splat formats against those of others, some minutes, into docs/results/benchmarks-formats.md
	$(BIN)/python -P benchmarks/formats.py --markdown docs/results/benchmarks-formats.md

bench-filters: setup ## filters among ellipsoids tick by tick, and the QP solver beside others, some minutes, into docs/results/benchmarks-filters.md
	$(BIN)/python -P benchmarks/filters.py --markdown docs/results/benchmarks-filters.md

bench-dracbf: setup ## filters among moving obstacles side by side, some minutes, into docs/results/benchmarks-dracbf.md
	$(BIN)/python -P benchmarks/dracbf.py --markdown docs/results/benchmarks-dracbf.md

bench-onboard: setup ## what the onboard filters take on emulated microcontrollers, into docs/results/onboard.md
	$(BIN)/python -P benchmarks/onboard.py --markdown docs/results/onboard.md

bench-betaflight: setup firmware ## fly the geofence through Betaflight's firmware, a minute, into docs/results/betaflight.md
	$(BIN)/python -P benchmarks/betaflight.py --markdown docs/results/betaflight.md

bench-alignment: setup ## how often the intervals of scale-align hold, some minutes
	$(BIN)/python -P benchmarks/alignment.py

bench-fly: setup ## fly the simulated autopilot in real time, some minutes, into docs/results/benchmarks-fly.md
	$(BIN)/python -P benchmarks/fly.py --markdown docs/results/benchmarks-fly.md

bench-autopilots: setup ## fly all filters on ALULA_ARDUCOPTER's program and on sim-vehicle, hours, into docs/results/benchmarks-fly.md
	$(BIN)/python -P benchmarks/autopilots.py --markdown docs/results/benchmarks-fly.md

bench-faults: setup ## make faults in flights of ALULA_ARDUCOPTER's program, an hour, into docs/results/benchmarks-fly.md
	$(BIN)/python -P benchmarks/faults.py --markdown docs/results/benchmarks-fly.md

bench-plan: setup ## plan between random pairs in the built-in room and real scenes and fly such plans, into docs/results/benchmarks-plan*.md
	$(BIN)/python -P benchmarks/plan.py --markdown docs/results/benchmarks-plan.md
	$(BIN)/python -P benchmarks/planned_flights.py --markdown docs/results/benchmarks-planned-flights.md

bench-pages: setup ## size of pages, and how soon they answer in a browser without a GPU, some minutes
	$(BIN)/python -P benchmarks/pages.py

bench-world: setup ## fly the combined scenario behind every list of filters, an hour, into docs/results/benchmarks-world.md
	$(BIN)/python -P benchmarks/world.py --trials $(or $(TRIALS),10000) --keep build/bench-world \
	  --markdown docs/results/benchmarks-world.md

docs: setup ## regenerate the command reference, and build the documentation into build/site/
	$(BIN)/python -P -m alula.cli.reference docs/guide/commands.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q
	@echo "documentation: $(CURDIR)/build/site/index.html"

man: setup ## write the man pages into build/man/
	$(BIN)/python -P -m alula.cli help --man build/man

schemas: setup ## regenerate what follows from the schemas, and the type stub of the native module
	$(BIN)/python -P -m alula.schemas.generate .
	$(BIN)/python -P -m nanobind.stubgen -q -m alula._core -o native/python/alula/_core.pyi

lock: ## pin every package with the hashes of its files, after a change of dependencies; needs uv
	.ci/lock

clean: ## remove everything that was made
	rm -rf build dist .venv examples/*/out .pytest_cache .mypy_cache .ruff_cache .hypothesis
