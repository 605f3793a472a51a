# Two commands from a fresh Debian or Ubuntu machine that has cargo (from rustup, which reads rust-toolchain.toml), git and make:
#
#   make demo   renders a small synthetic street with a six-camera rig and writes the pictures to out/demo
#   make test   runs every test, with the Vulkan validation layers on
#
# Both install what is missing through apt, and only then; sudo is used only by a user who is not root.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.PHONY: demo test packages

# Building needs a C++ compiler, cmake, ninja, pkg-config and python3 (for shaderc, which compiles the shaders); running
# needs the Vulkan loader, a driver (lavapipe, the software one, unless the machine has a better) and the validation layers.
PROGRAMS := g++ cmake ninja pkg-config python3
LIBRARIES := libvulkan1 mesa-vulkan-drivers vulkan-validationlayers

DEMO := out/demo
DECOUPLEGS := cargo run --quiet --package decouplegs-tools --

# The demo is built like the tests (optimised, see [profile.dev] in Cargo.toml), so that shaderc is compiled once for both.
# Its sizes are what lavapipe draws on two cores in half a minute.
demo: packages
	cargo build --package decouplegs-tools
	$(DECOUPLEGS) synth street --background 400000 --agents 8 --agent-splats 8000 --degree 1 --seed 7 --size 800x450 --out $(DEMO)/street
	$(DECOUPLEGS) render $(DEMO)/street/scene.toml --out $(DEMO) --contact-sheet $(DEMO)/contact-sheet.png
	@echo "The six pictures are in $(DEMO), side by side in $(DEMO)/contact-sheet.png."

# Documentation tests come first: what stands last in the output is the count of the tests proper.
test: export DECOUPLEGS_VALIDATION := 1
test: packages
	cargo test --workspace --doc
	if cargo nextest --version >/dev/null 2>&1; then \
		cargo nextest run --workspace --all-targets --no-fail-fast; \
	else \
		cargo test --workspace --lib --bins --tests --no-fail-fast; \
	fi

packages:
	@missing=(); \
	for program in $(PROGRAMS); do \
		command -v $$program >/dev/null || missing+=("$${program/#ninja/ninja-build}"); \
	done; \
	if ! command -v dpkg-query >/dev/null; then \
		echo "This is no Debian or Ubuntu: make sure that a Vulkan 1.3 loader and driver, the validation layers, $(PROGRAMS) are installed."; \
		exit 0; \
	fi; \
	for package in $(LIBRARIES); do \
		[[ "$$(dpkg-query --show --showformat='$${db:Status-Status}' $$package 2>/dev/null)" == installed ]] || missing+=("$$package"); \
	done; \
	if (( $${#missing[@]} == 0 )); then exit 0; fi; \
	echo "Installing $${missing[*]}"; \
	sudo=(); if (( EUID != 0 )); then sudo=(sudo); fi; \
	"$${sudo[@]}" apt-get update --quiet; \
	DEBIAN_FRONTEND=noninteractive "$${sudo[@]}" apt-get install --yes --quiet --no-install-recommends "$${missing[@]}"
