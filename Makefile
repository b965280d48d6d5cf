# make demo   the main job on two small simulated sequences; needs Python 3.11+, make and a package index
# make test   ruff, mypy, pytest
# make bench  our codec against others in turns, CPU time on one core; ROOT=DIR for recorded scans
# make fuzz   damaged input for every reader, 50,000 times
# make soak   100 killed workers, then 2,000 scans on two; ROOT=DIR for recorded ones
# make lock   pin the newest versions that pyproject.toml allows

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= $(shell for p in python3 python3.11 python3.12 python3.13; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
SOURCES := $(shell find schemas stages pipeline src/salpcc/__init__.py -type f -not -path '*/__pycache__/*') pyproject.toml
OUT ?= out/demo
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# What is imported is compiled then, by whichever process is first; pip would compile all that it installs, one file after another.
PIP := $(BIN)/pip install -q --no-compile
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test types test-stages test-pipeline test-rest bench fuzz soak lock clean

demo: $(VENV)/.product
	$(BIN)/salpcc-pipeline run sequences 00,01 --source simulated --frames 0:8 --keep-movable --out $(OUT)
	$(BIN)/salpcc-pipeline verify $(OUT)/archives/00.mcap --against $(OUT)/simulated
	$(BIN)/salpcc-pipeline verify $(OUT)/archives/01.mcap --against $(OUT)/simulated
	@echo "The report: $(CURDIR)/$(OUT)/report/index.html"

# pip takes one of two cores for a minute or two: the other compiles what most tests need.
test: $(VENV)/.product
	$(MAKE) -j 2 $(VENV)/.tools $(VENV)/.kernels
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(MAKE) -j 2 test-stages types test-rest test-pipeline

types:
	$(BIN)/mypy -p salpcc

# Three processes, two at a time: a process that a native library ends is told of, which pytest-xdist waits for for ever.
# The pipeline's comes last, and fuzz with it: by then the stages' has compiled most kernels of both.
test-stages:
	$(BIN)/pytest -q tests/stages tests/schemas tests/scripts
test-pipeline:
	$(BIN)/pytest -q tests/pipeline tests/examples tests/test_fuzz.py
test-rest:
	$(BIN)/pytest -q $(filter-out tests/test_fuzz.py,$(wildcard tests/test_*.py))

bench: $(VENV)/.tools
	$(BIN)/python -m salpcc.stages.evaluate.studies.bench --efforts fast,default,max --threads 2 --profile-stages $(if $(ROOT),--root $(ROOT))

fuzz: $(VENV)/.tools
	$(BIN)/python tests/fuzz --count 50000

soak: $(VENV)/.tools
	SALPCC_KILLS=100 $(BIN)/pytest -q tests/pipeline/test_faults.py -k killed_workers
	$(BIN)/python tests/soak.py $(if $(ROOT),--data $(ROOT))

# The lock file constrains, so that pip has nothing to choose, and the demo installs what runs and no tool.
# An ordinary install, not an editable one: what is tested is what users get.
$(VENV)/.product: requirements.lock $(SOURCES)
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11"; exit 2; }
	@rm -rf build/lib #  modules that are gone from the sources would be installed from there
	$(PYTHON) -m venv $(VENV)
	$(PIP) -c requirements.lock ".[run]"
	@touch $@

# The tools, the other codecs, Open3D.
$(VENV)/.tools: $(VENV)/.product
	$(PIP) -r requirements.lock
	@touch $@

# Without these, tests compile for themselves: a failure is theirs to tell.
$(VENV)/.kernels: $(VENV)/.product
	-$(BIN)/python tests/golden/coded_again.py tests/golden/*.mcap > /dev/null
	@touch $@

# torch stays as it is until somebody edits the lock: most of its releases bring gigabytes of CUDA along.
lock:
	rm -rf build/lock && $(PYTHON) -m venv build/lock
	grep '^torch==' requirements.lock > build/lock/torch.txt
	build/lock/bin/pip install -q -c build/lock/torch.txt ".[all,dev,open3d]"
	build/lock/bin/python scripts/lock.py build/lock > requirements.lock.new
	mv requirements.lock.new requirements.lock

clean:
	rm -rf $(VENV) build out *.egg-info
