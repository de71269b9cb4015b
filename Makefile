# Two commands: `make bench` runs the paper's simulations, `make test` everything that CI runs.
VENV ?= .venv
OUT ?= out
PY := $(VENV)/bin/python

.PHONY: install bench test lint types layers unit system benchmark wheel clean

install:
	@tools/install.sh $(VENV)

bench: install
	$(VENV)/bin/hil-forceps bench --config configs/paper.yaml --out $(OUT)/paper
	$(VENV)/bin/hil-forceps bench --config configs/realistic.yaml --out $(OUT)/realistic

test: lint types layers unit system

lint: install
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

types: install
	$(VENV)/bin/mypy

layers: install
	$(VENV)/bin/lint-imports

unit: install
	$(PY) -m pytest -n 2 tests --ignore=tests/system --ignore=tests/bench

# One process and nothing beside it: these start processes of their own and watch the clock.
system: install
	$(PY) -m pytest tests/system

# Figures of speed; apart from the tests because they mean nothing on a busy machine.
benchmark: install
	$(PY) -m pytest tests/bench --benchmark-columns=min,median,iqr,rounds -p no:xdist

wheel: install
	$(PY) -m build --wheel --no-isolation

clean:
	rm -rf $(VENV) $(OUT) build dist
