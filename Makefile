# One environment for everything; `make demo` and `make test` are all a newcomer needs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# At least two workers: compiling is what costs, and it runs beside other tests.
WORKERS ?= 2

.PHONY: demo test slow lint docs bench clean

$(VENV)/ready: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[app,plaza]"
	touch $@

$(VENV)/ready-test: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --editable ".[app,plaza,test,docs]"
	touch $@

$(VENV)/ready-bench: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --editable ".[app,plaza,bench]"
	touch $@

demo: $(VENV)/ready
	$(BIN)/sigmax track plaza1

lint: $(VENV)/ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint
	$(BIN)/pytest -m "not slow" -n $(WORKERS) --dist worksteal
	$(BIN)/mkdocs build --strict --quiet --site-dir build/site

# As a whole, or a part of it: make slow SLOW=tests/studies
SLOW ?= tests
slow: $(VENV)/ready-test
	$(BIN)/pytest -m slow -n $(WORKERS) --dist worksteal $(SLOW)

docs: $(VENV)/ready-test
	$(BIN)/mkdocs serve

bench: $(VENV)/ready-bench
	$(BIN)/python benchmarks/speed.py --write benchmarks/README.md
	$(BIN)/python benchmarks/large.py --write benchmarks/README.md

clean:
	rm -rf $(VENV) build dist site
