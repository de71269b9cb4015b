# Two commands: `make bench` runs the paper's simulations, `make test` what every change has to pass. CI runs
# `make test-long` besides: what takes tens of seconds a test and has a shorter one beside it, and all targets.
VENV ?= .venv
OUT ?= out
PY := $(VENV)/bin/python
TESTS := tests --ignore=tests/targets --ignore=tests/bench
# Tests run in as many processes as there are cores; threads of BLAS beside them would only fight for these.
export OPENBLAS_NUM_THREADS := 1
# Optimised at level 2, kernels are as fast as at 3, numba's own, and compile in three quarters of the time.
export NUMBA_OPT ?= 2
# Containers often set it. Then every process of a test compiles all that it imports, two seconds of it, and pytest
# rewrites every test file anew at each run.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install install-run site bench test test-long lint types layers unit system targets targets-short targets-quick effects gate-coverage mutate-gate fuzz fuzz-readers campaign torque-free hidden-effects real-data drive-costs trend-speed benchmark audit wheel clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1\t\2/p' Makefile | expand -t 18

install:  ## make .venv from requirements.lock
	@tools/installation/install.sh $(VENV)

install-run:
	@tools/installation/install.sh $(VENV) run

bench: install-run  ## the paper's simulations through the bus: table, figures, recordings in $(OUT)
	$(VENV)/bin/hil-forceps bench --config configs/paper.yaml --out $(OUT)/paper
	$(VENV)/bin/hil-forceps bench --config configs/realistic.yaml --out $(OUT)/realistic

# What computes first, two at a time; then what watches the clock. Some 4 minutes more the first time, where SocketCAN
# needs a kernel built.
test: lint types layers unit system targets-quick  ## everything that a change has to pass

lint: install  ## style
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

types: install  ## types, strict, tests too
	$(VENV)/bin/mypy

layers: install  ## import contracts
	$(VENV)/bin/lint-imports

unit: install  ## tests in virtual time
	$(PY) -m pytest -n 2 --dist loadgroup -m "not realtime and not long and not campaign" $(TESTS)

test-long: targets-short  ## what takes tens of seconds a test; CI runs it behind `make test`
	$(PY) -m pytest -n 2 --dist loadgroup -m "long" $(TESTS)

# These start processes of their own and watch the clock. Hosts of 100 Hz bear another test beside them; what runs at 1 kHz
# or draws in a browser has the machine to itself. On one that others use, too, a process may be kept waiting for longer
# than a drive waits: then a test is tried again, and the summary says so.
AGAIN := --reruns 2 --only-rerun AssertionError
system: install  ## tests that need a clock: processes, terminals, sockets, a browser
	-@tools/installation/install_browser.sh
	$(PY) -m pytest -n 2 --dist worksteal -m "realtime and not alone" $(AGAIN) $(TESTS)
	$(PY) -m pytest -m "realtime and alone" $(AGAIN) $(TESTS)

# Conformance and simulation 2 on every target that this machine can have, then the table of what ran. What runs in
# virtual time goes first, for it needs no quiet machine. `make targets` closes the loop over the 20 s of the paper and
# runs one real-time target at a time: for figures to publish, on a machine with nothing else to do. In
# `make targets-short` it is 3 s, two at a time, and emulated machines are spared the flood of frames; `targets-quick` has
# one target of each kind.
targets: export HIL_FORCEPS_TARGETS_FULL = 1
targets: TARGET_JOBS = 1
targets: TARGET_RERUNS = 0
targets-short: TARGET_JOBS = 2
targets-short: TARGET_RERUNS = 1
targets: ## conformance and simulation 2 on every target that this machine can have
targets-short: ## the same, short
targets targets-short: install
	rm -rf build/targets
	-@tools/installation/install_targets.sh
	status=0; \
		$(PY) -m pytest -n 2 --dist worksteal -m "not realtime" tests/targets || status=1; \
		$(PY) -m pytest -n $(TARGET_JOBS) --dist worksteal -m realtime --reruns $(TARGET_RERUNS) tests/targets || status=1; \
		$(PY) -m tools.targets.target_table || status=1; \
		exit $$status

targets-quick: install  ## one emulated target of each kind
	-@tools/installation/install_targets.sh
	$(PY) -m pytest -n 2 --dist worksteal -m "not realtime and not long" tests/targets
	$(PY) -m pytest -n 2 --dist worksteal -m "realtime and not long" --reruns 1 tests/targets

# Behind a change in `hil_forceps/effects` or `virtual_bus/effects`; the tests tell when it was forgotten.
effects: install  ## put model and world together from the files of their effects
	$(PY) -m tools.generation.compose_effects
	$(PY) tools/documents/rig_file_doc.py

# Its kernels run as plain Python for both: coverage and mutants see nothing of compiled code.
gate-coverage mutate-gate: export NUMBA_DISABLE_JIT = 1
gate-coverage: install  ## the gate: all lines and branches by its own tests
	$(PY) -m pytest -n 0 -q tests/unit/control/gate --cov=hil_forceps.control.gate --cov-branch \
		--cov-report=term-missing --cov-fail-under=100

# Each survivor is explained in docs/safety-gate.md; one that isn't there is a test that is missing.
mutate-gate: gate-coverage  ## the gate: which changes of its code its tests don't see; some 5 minutes
	rm -rf mutants && mkdir -p build
	$(VENV)/bin/mutmut run --max-children 2 >build/mutate-gate.txt 2>&1 || tail -c 2000 build/mutate-gate.txt
	$(PY) -m tools.mutation.gate_survivors

# Ten million bytes into every reader and state machine of the Python side.
fuzz: install  ## ten million bytes into every reader and state machine
	$(PY) -m firmware_protocol.conformance.fuzz 10000000

# Damaged files into every reader of logs, tables, recordings, rigs: some 2 ms an input. 100 000 take four minutes of a
# core, N=10000000 a night of several: give each core a SEED of its own. The same N and SEED give the same inputs.
N ?= 100000
SEED ?= 0
fuzz-readers: install  ## damaged files into every reader, N=100000 of them; N=10000000 at night
	$(PY) -m tests.reader_fuzz.campaign $(N) --seed $(SEED) --out $(OUT)/reader-fuzz

# Schedules of faults on bus, drive, host and clock, N seeds from SEED on: some 0.1 s each on a core. What fails is shrunk,
# and told with the command that makes it again.
campaign: N = 1000
campaign: install  ## faults on bus, drive, host and clock in virtual time: N=1000 seeds; N=10000 at night
	$(PY) -m tests.fault_campaign.campaign $(N) --seed $(SEED) --out $(OUT)/fault-campaign

# Offline, from docs/, README.md and what the program tells of itself; warnings are errors.
site: install  ## the documents as a site, build/site/index.html
	$(PY) -m tools.site

torque-free: install  ## time from the last reference to no torque, of every simulated drive: table and figure
	$(PY) -m tests.fault_campaign.torque_free --out $(OUT)/torque-free

# Effects hidden in data and diagnosed, hours of it; goes on where it was stopped. Then the tables of docs/diagnosis.md.
hidden-effects: install  ## the campaign of effects hidden in data; hours
	$(PY) -m tests.hidden_effects.drawn_campaign --out $(OUT)/drawn-effects --usual --jobs 2
	$(PY) -m tests.hidden_effects.drawn_campaign --out $(OUT)/drawn-effects --jobs 2
	$(PY) -m tests.hidden_effects.drawn_campaign --out $(OUT)/drawn-effects --counts

# The ladders of the surgical tool, where its data are beside this folder or at HIL_FORCEPS_DATA; some 6 minutes.
real-data: install  ## ladders on measured data of a surgical tool; minutes
	$(PY) -m pytest -m campaign tests/unit

# N=1000 logs of 12 s take ten minutes of two cores, and as long again to be simulated the first time.
trend-speed: N = 100
trend-speed: install  ## what tracking N simulated logs takes: N=1000
	$(PY) -m tests.bench.trend_logs $(N) --out $(OUT)/trend-logs

drive-costs: install  ## what each drive's protocol costs: table and figure
	$(PY) -m tools.drives.drive_costs --out $(OUT)/drive-costs

# Figures of speed; apart from the tests because they mean nothing on a busy machine.
benchmark: install  ## figures of speed
	$(PY) -m pytest tests/bench --timeout 3600 --benchmark-columns=min,median,iqr,rounds -p no:xdist

# Asks a database of vulnerabilities over the network, so it is no part of `make test`.
audit:  ## known vulnerabilities of the locked dependencies; needs a network
	@tools/release/audit.sh

wheel: install  ## the wheel, in dist/
	$(PY) -m build --wheel --no-isolation

clean:  ## remove .venv, results and builds
	rm -rf $(VENV) $(OUT) build dist
