# The two commands of a fresh machine are `make demo` and `make test`; they make their own virtual environment.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO := $(VENV)/.demo

# Hundreds of tests start Python anew, which must not compile framekit every time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test check lint bench docs guess-score clean

demo: $(DEMO)
	$(BIN)/framekit demo

test: $(STAMP)
	$(BIN)/python -m pytest -q -n auto --dist worksteal $(WHICH)

check: lint test

lint: $(STAMP)
	$(BIN)/ruff check framekit tests benchmarks examples tools
	$(BIN)/ruff format --check framekit tests benchmarks examples tools
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)
	$(BIN)/python -m benchmarks

docs: $(STAMP)
	$(BIN)/python tools/site.py
	@echo "build/site/index.html"

guess-score: $(STAMP)
	$(BIN)/python -m benchmarks.guess_score
	$(BIN)/python -m benchmarks.guess_real

$(STAMP): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $(STAMP) $(DEMO)

# A demonstration needs framekit alone, not the tools of its developers.
$(DEMO): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $(DEMO)

clean:
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis
