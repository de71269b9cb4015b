# Two commands: `make bench` runs the paper's simulations, `make test` everything that CI runs.
VENV ?= .venv
OUT ?= out
TARGET_JOBS ?= 2
PY := $(VENV)/bin/python

.PHONY: install bench test lint types layers unit system targets targets-virtual fuzz hidden-effects benchmark wheel clean

install:
	@tools/install.sh $(VENV)

bench: install
	$(VENV)/bin/hil-forceps bench --config configs/paper.yaml --out $(OUT)/paper
	$(VENV)/bin/hil-forceps bench --config configs/realistic.yaml --out $(OUT)/realistic

# The targets that watch a real clock, or need a kernel or an emulator of their own, are `make targets`.
test: lint types layers unit system targets-virtual

lint: install
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

types: install
	$(VENV)/bin/mypy

layers: install
	$(VENV)/bin/lint-imports

unit: install
	$(PY) -m pytest -n 2 tests --ignore=tests/system --ignore=tests/targets --ignore=tests/bench

# One process and nothing beside it: these start processes of their own and watch the clock.
system: install
	$(PY) -m pytest tests/system

# The Python drive and the emulated STM32, both in virtual time.
targets-virtual: install
	$(PY) -m pytest tests/targets/test_unicorn.py tests/targets/test_python_drive.py -k "not pty and not multicast"

# Conformance and simulation 2 on every target that this machine can have, then the table of what ran; a file of tests at
# a time in each job. For figures worth publishing: TARGET_JOBS=1 and a machine with nothing else to do.
targets: install
	rm -rf build/targets
	-@tools/install_targets.sh
	$(PY) -m pytest -n $(TARGET_JOBS) --dist loadfile tests/targets; status=$$?; \
		$(PY) -m tools.target_table || status=1; exit $$status

# Ten million bytes into every reader and state machine of the Python side.
fuzz: install
	$(PY) -m firmware_protocol.conformance.fuzz 10000000

# Effects hidden in data and diagnosed, hours of it; goes on where it was stopped. Then the tables of docs/diagnosis.md.
hidden-effects: install
	$(PY) -m tests.hidden_effects.campaign --out $(OUT)/hidden-effects --jobs 2 --resume
	$(PY) -m tests.hidden_effects.tally $(OUT)/hidden-effects --markdown docs/diagnosis.md --figures docs/figures

# Figures of speed; apart from the tests because they mean nothing on a busy machine.
benchmark: install
	$(PY) -m pytest tests/bench --benchmark-columns=min,median,iqr,rounds -p no:xdist

wheel: install
	$(PY) -m build --wheel --no-isolation

clean:
	rm -rf $(VENV) $(OUT) build dist
