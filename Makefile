# `make demo` and `make test` are all a newcomer needs; both set up .venv on their first call.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Up to four workers, a file of tests at a time: files share what is costly to make.
SIDE_BY_SIDE := -n auto --maxprocesses 4 --dist loadfile

.PHONY: demo test test-slow stability clusters effects benchmark lint clean
demo: $(STAMP)
	$(BIN)/napari-deltamic demo

test: $(STAMP)
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/mypy
	$(BIN)/python -m pytest $(SIDE_BY_SIDE)

test-slow: $(STAMP)
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) -m slow

stability: $(STAMP)
	$(BIN)/python -m pytest tests/stability -m ""
	$(BIN)/python -m benchmarks.stability

clusters: $(STAMP)
	$(BIN)/python -m benchmarks.clusters --write

effects: $(STAMP)
	$(BIN)/python -m benchmarks.effects --write

benchmark: $(STAMP)
	$(BIN)/python -m benchmarks --page docs/benchmarks.md
	$(BIN)/python -m benchmarks.accuracy

lint: $(STAMP)
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/mypy

# Everything is pinned in constraints.txt; torch goes first and alone, since an open range would
# pull several gigabytes of CUDA packages.
$(STAMP): pyproject.toml CMakeLists.txt constraints.txt $(wildcard csrc/*)
	test -d $(VENV) || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q -c constraints.txt torch
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[qt,test,benchmark]"
	touch $@

clean:
	rm -rf $(VENV) build demo-output
