# Two commands from a fresh Debian or Ubuntu machine that has cargo (from rustup, which reads rust-toolchain.toml), git and make:
#
#   make demo     renders a small synthetic street with a six-camera rig and writes the images to out/demo
#   make test     runs every test, with the Vulkan validation layers on
#
# One to install the program `decouplegs`, and those that it runs:
#
#   make install  builds them, optimized, and copies them to cargo's folder of programs
#
#   make install-c PREFIX=...  the library for C and C++, with its header, for pkg-config and CMake (default: ~/.local)
#
# One to change a shader:
#
#   make shaders  compiles shaders/*.comp to shaders/spirv with shaderc, and writes their interfaces as Rust to shaders/interfaces. The first time it builds shaderc: about eight minutes.
#
# And those that attack the programs, for a night (FUZZ_SECONDS, ABUSE_TRIES and SOAK_SECONDS say how long):
#
#   make fuzz     gives damaged files to every reader
#   make abuse    damages files, fills disks, kills, and sends garbage to the viewer and the server
#   make soak     lets the server and the closed loop work, and tells whether their memory grows
#   make asan     runs the tests of C and Python under AddressSanitizer
#
# Each installs through apt what is missing; sudo is used only by a user who is not root.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.PHONY: demo test install install-c fuzz abuse soak asan shaders shaders-check python-test wheel-test packages ci-packages python browser torch ncore nuscenes

# What each target needs, as `program` (found in the path; its package has the same name) or `=package` (asked of dpkg).
# A build needs a linker and a C compiler, a run the Vulkan loader and a driver (lavapipe, the software one, unless the machine has a better).
# Tests also need the validation layers, C++, Python, valgrind, strace and pkg-config. Only shaderc needs cmake, ninja and python3.
NEEDS_RUN := gcc =libc6-dev =libvulkan1 =mesa-vulkan-drivers
NEEDS_TEST := $(NEEDS_RUN) g++ python3 =python3-venv =vulkan-validationlayers valgrind strace pkg-config
NEEDS_SHADERC := gcc g++ cmake ninja python3
NEEDS_CI := $(sort $(NEEDS_TEST) $(NEEDS_SHADERC))
NEEDS = $(NEEDS_TEST)

# Tests use the project from Python as users do: they read compressed assets, build and install the wheel, speak to the server and
# drive episodes on a cluster of this machine. A test whose package cannot be installed says that it is skipped.
PYTHON_PACKAGES := safetensors numpy maturin pytest pytest-xdist gymnasium matplotlib grpcio protobuf
PYTHON_PACKAGES_OPTIONAL := ray playwright axe-core-python grpcio-tools hugsim-client requests tenacity mcap mcap-ros2-support \
	carla-driver-interface pycocotools onnxruntime onnx
# Without their own dependencies: torch and NumPy are the system's.
NCORE_PACKAGES := nvidia-ncore==19.8.3 dataclasses_json marshmallow typing_inspect mypy_extensions 'zarr<3' 'numcodecs<0.16' asciitree deprecated wrapt fasteners cbor2 'scipy<1.13' \
	pillow universal_pathlib fsspec pathlib_abc packaging typing_extensions
NCORE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/decouplegs/ncore
# Without its own dependencies: they pin old versions of NumPy and Matplotlib, and it needs neither these versions nor most of the packages.
NUSCENES_PACKAGES := nuscenes-devkit==1.2.0 pyquaternion cachetools tqdm opencv-python-headless scikit-learn joblib threadpoolctl narwhals fire descartes shapely
NUSCENES := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/decouplegs/nuscenes
PYTHON := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/decouplegs/python

DEMO := out/demo
DECOUPLEGS := cargo run --quiet --package decouplegs-tools --

# Folders of the packages of all programs: `decouplegs` first, then those that it runs.
PROGRAMS := tools tools/drive tools/view tools/server benches

# The demo is built like the tests (optimized, see [profile.dev] in Cargo.toml), but for the features that only other programs ask of shared crates.
# Its sizes are what lavapipe draws on two cores in half a minute.
demo: NEEDS := $(NEEDS_RUN)
demo: packages
	cargo build --package decouplegs-tools
	$(DECOUPLEGS) synth street --background 400000 --agents 8 --agent-splats 8000 --degree 1 --seed 7 --size 800x450 --movable --force --out $(DEMO)/street
	$(DECOUPLEGS) render $(DEMO)/street/scene.toml --force --out $(DEMO) --contact-sheet $(DEMO)/contact-sheet.png
	@echo "The six images are in $(DEMO), side by side in $(DEMO)/contact-sheet.png."
	@echo "To look around in the street:  cargo run --package decouplegs-view -- view"

install: NEEDS := $(NEEDS_RUN)
install: packages
	for folder in $(PROGRAMS); do cargo install --locked --path $$folder; done

# What is installed may be moved. DESTDIR comes before PREFIX, for those who make packages.
PREFIX ?= $(HOME)/.local
install-c: NEEDS := gcc =libc6-dev python3
install-c: packages
	cargo build --release --locked --package decouplegs-c
	sh tools/c/install/install.sh $(TARGET)/release $(DESTDIR)$(PREFIX) $$(cargo pkgid --package decouplegs-c | sed 's/.*[#@]//')

# Folder of what is built, also where CARGO_TARGET_DIR or a configuration of cargo names another one.
TARGET = $(shell cargo metadata --format-version 1 --no-deps | python3 -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
TOOLS := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/decouplegs/tools

FUZZ_SECONDS ?= 60
fuzz: NEEDS := gcc g++ =libc6-dev python3
fuzz: export PATH := $(TOOLS)/bin:$(PATH)
fuzz: packages
	cargo fuzz --version >/dev/null 2>&1 || CARGO_TARGET_DIR=$(TOOLS)/target cargo install --quiet --locked --root $(TOOLS) cargo-fuzz
	engine/asset/fuzz/run.py --seconds $(FUZZ_SECONDS) --out out/fuzz

ABUSE_TRIES ?= 20
abuse: NEEDS := $(NEEDS_RUN) python3
abuse: packages
	cargo build --workspace
	python3 tests/abuse/abuse.py --program $(TARGET)/debug/decouplegs --tries $(ABUSE_TRIES)

SOAK_SECONDS ?= 7200
soak: NEEDS := $(NEEDS_RUN) python3 =python3-venv
soak: packages python browser
	cargo build --workspace
	ln -sf "$(TARGET)/debug/libdecouplegs_native.so" tools/python/decouplegs/_native.abi3.so
	python3 tests/abuse/soak.py --program $(TARGET)/debug/decouplegs --seconds $(SOAK_SECONDS) --python $(PYTHON)/bin/python

# A program that is not built for AddressSanitizer must load it first. Leaks are left to valgrind, which knows those of drivers. rustc takes
# the option as an unstable one. Of the tests of C, one runs valgrind, which cannot run such programs, and one installs what no program is linked with.
asan: export RUSTC_BOOTSTRAP := 1
asan: export ASAN_OPTIONS := detect_leaks=0:exitcode=99
asan: export DECOUPLEGS_CFLAGS := -fsanitize=address
asan: packages python
	host=$$(rustc -vV | sed -n 's/^host: //p'); \
	export RUSTFLAGS=-Zsanitizer=address; \
	cargo build --target $$host --package decouplegs-c --package decouplegs-python; \
	cargo test --target $$host --package decouplegs-c --package decouplegs-python --tests -- \
		--skip the_example_touches_only_its_own_memory --skip installed; \
	ln -sf "$(TARGET)/$$host/debug/libdecouplegs_native.so" tools/python/decouplegs/_native.abi3.so; \
	export LD_PRELOAD=$$(gcc -print-file-name=libasan.so) PYTHONMALLOC=malloc PYTHONPATH=tools/python; \
	$(PYTHON)/bin/python -m pytest -q $(addprefix tools/python/tests/,test_memory.py test_misuse.py test_drawing.py test_dlpack.py test_cameras.py test_lidar.py)

# Documentation tests come first: what stands last in the output is the count of the tests proper.
test: export DECOUPLEGS_VALIDATION := 1
test: packages python
	cargo test --workspace --doc
	if [[ -x $(PYTHON)/bin/python ]]; then export DECOUPLEGS_PYTHON=$(PYTHON)/bin/python; fi; \
	if cargo nextest --version >/dev/null 2>&1; then \
		cargo nextest run --workspace --all-targets --no-fail-fast; \
	else \
		cargo test --workspace --lib --bins --tests --no-fail-fast; \
	fi
	$(MAKE) --no-print-directory python-test

shaders: NEEDS := $(NEEDS_SHADERC)
shaders: packages
	cargo run --quiet --package decouplegs-shaders --features compile

# Fails if the SPIR-V in shaders/spirv is not what shaderc makes of the shaders, or shaders/interfaces not what is read from it.
shaders-check: NEEDS := $(NEEDS_SHADERC)
shaders-check: packages
	cargo run --quiet --package decouplegs-shaders --features compile -- --check

# The Python package over the library that the tests' own build makes: a wheel would compile everything once more.
python-test: export DECOUPLEGS_VALIDATION := 1
python-test: packages python browser torch ncore nuscenes
	@if ! [[ -x $(PYTHON)/bin/pytest ]]; then echo "The Python package is not tested: pytest could not be installed."; exit 0; fi; \
	cargo build --workspace --all-targets; \
	target=$$(cargo metadata --format-version 1 --no-deps | $(PYTHON)/bin/python -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])'); \
	ln -sf "$$target/debug/libdecouplegs_native.so" tools/python/decouplegs/_native.abi3.so; \
	DECOUPLEGS_PROGRAM="$$target/debug/decouplegs" DECOUPLEGS_NCORE=$(NCORE) DECOUPLEGS_NUSCENES=$(NUSCENES) PYTHONPATH=tools/python \
		$(PYTHON)/bin/python -m pytest -q --numprocesses auto --dist worksteal tools/python/tests tools/view/tests

# As a user installs it: the wheel, in an environment that has nothing else, and its tests there.
wheel-test: export DECOUPLEGS_VALIDATION := 1
wheel-test: packages
	rm -rf out/wheel && python3 -m venv out/wheel
	out/wheel/bin/pip install --quiet --disable-pip-version-check './tools/python[test]'
	cd out/wheel && bin/python -m pytest -q ../../tools/python/tests

# Without a network the test that needs it says that it is skipped.
python: packages
	@if $(PYTHON)/bin/python -c 'import safetensors, numpy, maturin, pytest, xdist, gymnasium, matplotlib, grpc, playwright, hugsim_client, mcap_ros2, grpc_tools, carla_driver_interface, pycocotools, onnxruntime, onnx' 2>/dev/null; then exit 0; fi; \
	python3 -m venv $(PYTHON) && $(PYTHON)/bin/pip install --quiet --disable-pip-version-check $(PYTHON_PACKAGES) \
		|| { rm -rf $(PYTHON); echo "$(PYTHON_PACKAGES) cannot be installed for Python: the tests that need them are skipped."; exit 0; }; \
	for package in $(PYTHON_PACKAGES_OPTIONAL); do \
		$(PYTHON)/bin/pip install --quiet --disable-pip-version-check $$package \
			|| echo "$$package cannot be installed for Python: the tests that need it are skipped."; \
	done

# The browser that the viewer's page is tested in. Ubuntu has it as a snap alone: the tests are skipped there, unless it is installed.
browser:
	@if command -v chromium chromium-browser >/dev/null || ! command -v apt-get >/dev/null; then exit 0; fi; \
	echo "Installing chromium"; \
	sudo=(); if (( EUID != 0 )); then sudo=(sudo); fi; \
	"$${sudo[@]}" apt-get update --quiet; \
	DEBIAN_FRONTEND=noninteractive "$${sudo[@]}" apt-get install --yes --quiet --no-install-recommends chromium \
		|| echo "chromium cannot be installed: the tests of the viewer's page are skipped."

# PyTorch, which writes the checkpoints that readers are tested with. Its package is for the system's Python; PyPI has none without CUDA.
torch:
	@if /usr/bin/python3 -c 'import torch' 2>/dev/null || ! command -v apt-get >/dev/null; then exit 0; fi; \
	echo "Installing python3-torch"; \
	sudo=(); if (( EUID != 0 )); then sudo=(sudo); fi; \
	"$${sudo[@]}" apt-get update --quiet; \
	DEBIAN_FRONTEND=noninteractive "$${sudo[@]}" apt-get install --yes --quiet --no-install-recommends python3-torch \
		|| echo "python3-torch cannot be installed: the tests of checkpoints that PyTorch writes are skipped."

# NVIDIA's camera models, which lenses are compared with, for the Python that has torch. Its wheels are those of the same version of Python.
ncore: python torch
	@if [[ -d $(NCORE)/ncore ]] || ! /usr/bin/python3 -c 'import torch' 2>/dev/null || ! [[ -x $(PYTHON)/bin/pip ]]; then exit 0; fi; \
	if [[ $$(/usr/bin/python3 -c 'import sys; print(sys.version_info[:2])') != $$($(PYTHON)/bin/python -c 'import sys; print(sys.version_info[:2])') ]]; then exit 0; fi; \
	rm -rf $(NCORE).part; \
	if $(PYTHON)/bin/pip install --quiet --disable-pip-version-check --no-deps --target $(NCORE).part $(NCORE_PACKAGES); then \
		mv $(NCORE).part $(NCORE); \
	else \
		echo "nvidia-ncore cannot be installed: lenses are not compared with it."; \
	fi

# The reader of nuScenes, which exported episodes are opened with.
nuscenes: python
	@if [[ -d $(NUSCENES)/nuscenes ]] || ! [[ -x $(PYTHON)/bin/pip ]]; then exit 0; fi; \
	rm -rf $(NUSCENES).part; \
	if $(PYTHON)/bin/pip install --quiet --disable-pip-version-check --no-deps --target $(NUSCENES).part $(NUSCENES_PACKAGES); then \
		mv $(NUSCENES).part $(NUSCENES); \
	else \
		echo "nuscenes-devkit cannot be installed: exported data sets are not opened with it."; \
	fi

# Everything that `.ci/run` compiles and runs, shaderc included.
ci-packages: NEEDS := $(NEEDS_CI)
ci-packages: packages

packages:
	@missing=(); \
	if ! command -v dpkg-query >/dev/null; then \
		echo "This is no Debian or Ubuntu: make sure that these are installed: $(subst =,,$(NEEDS))"; \
		exit 0; \
	fi; \
	for need in $(NEEDS); do \
		package=$${need#=}; \
		if [[ $$need == =* ]]; then \
			[[ "$$(dpkg-query --show --showformat='$${db:Status-Status}' $$package 2>/dev/null)" == installed ]] || missing+=("$$package"); \
		else \
			command -v $$need >/dev/null || missing+=("$${package/#ninja/ninja-build}"); \
		fi; \
	done; \
	if (( $${#missing[@]} == 0 )); then exit 0; fi; \
	echo "Installing $${missing[*]}"; \
	sudo=(); if (( EUID != 0 )); then sudo=(sudo); fi; \
	"$${sudo[@]}" apt-get update --quiet; \
	DEBIAN_FRONTEND=noninteractive "$${sudo[@]}" apt-get install --yes --quiet --no-install-recommends "$${missing[@]}"
