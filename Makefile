# `make demo`, `make test` and `make bench` do all the set-up themselves, in .venv.
# A stamp file remembers it, so that the second call starts at once.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
OUT := out
# One worker keeps a whole file, so no program is compiled by both.
PYTEST := $(BIN)/python -m pytest -q -n 2 --dist loadfile

.PHONY: demo test lint fast slow bench clean

demo: $(VENV)/demo.stamp
	$(BIN)/jaxtrack compare yuan2013-linear --runs 100 --seed 0 \
	    --trackers gm-mm-cbmember,gm-cv-cbmember,gm-ct-cbmember --out $(OUT)/compare
	$(BIN)/jaxtrack track --harbour --out $(OUT)/harbour
	@echo "Pictures:" && ls $(OUT)/compare/*.png $(OUT)/harbour/*.png

test: lint fast slow

lint: $(VENV)/test.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

fast: $(VENV)/test.stamp
	$(PYTEST) -m "not slow"

slow: $(VENV)/test.stamp
	$(PYTEST) -m slow

# Writes benchmarks/results/latest.json and the table in README.md.
bench: $(VENV)/bench.stamp
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) $(OUT) .cache .pytest_cache .ruff_cache build dist

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed." >&2; exit 1; }
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and \
	    "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11 ...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/demo.stamp: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet -e ".[cli,plot,io,data]"
	touch $@

$(VENV)/test.stamp: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet -e ".[cli,plot,io,data,test,notebooks]"
	touch $@

$(VENV)/bench.stamp: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet -e ".[io,bench]"
	touch $@
