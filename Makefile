# make demo [SOURCE=path], make test, make check, make bench, make picture.
# PYTHON names the interpreter for the environment. SOURCE is an image, a folder of images, a video, or PVDN; left out, it is
# the real frame beside the checkout where there is one.
PYTHON ?= python3
SOURCE ?= $(wildcard ../shared/data/pvdn_frame_047433.png)
VENV := .venv
BIN := $(VENV)/bin
NATIVE := $(shell find native CMakeLists.txt -name '*.?pp' -o -name '*.inl' -o -name CMakeLists.txt)
export OMP_WAIT_POLICY ?= PASSIVE

.PHONY: demo test check bench picture clean

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

# The package alone is enough for the demo; developing adds the training stack, the tests and the checkers.
$(VENV)/.run: $(BIN)/python pyproject.toml $(NATIVE)
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.dev: $(BIN)/python pyproject.toml constraints.txt $(NATIVE)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@ $(VENV)/.run

demo: $(VENV)/.run
	$(BIN)/foreglow demo $(if $(SOURCE),"$(SOURCE)")

test: $(VENV)/.dev
	$(BIN)/python -m pytest

check: $(VENV)/.dev
	$(BIN)/ruff format --check src tests benchmarks
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/mypy
	$(BIN)/python -m pytest --quiet
	$(BIN)/cmake -S native -B build/sanitized -DFOREGLOW_SANITIZE=ON -DCMAKE_BUILD_TYPE=RelWithDebInfo
	MAKEFLAGS= $(BIN)/cmake --build build/sanitized
	build/sanitized/core_test

bench: $(VENV)/.dev
	$(BIN)/python -m benchmarks.detector
	$(BIN)/python -m benchmarks.classifier

# The picture of the README, from a generated frame.
picture: $(VENV)/.dev
	$(BIN)/python -m benchmarks.synthetic_frames bench_output/synthetic
	$(BIN)/foreglow run bench_output/synthetic/000000.png --out bench_output/picture --video
	cp bench_output/picture/overlay.png docs/images/synthetic_road.png

clean:
	rm -rf $(VENV) build demo_output bench_output
