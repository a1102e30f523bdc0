# One command per check. PYTHON chooses the environment.
PYTHON ?= python

.PHONY: all lint format types test slow mutants kernels lowest docs package clean

all: lint test

lint:
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .

format:
	$(PYTHON) -m ruff check --fix .
	$(PYTHON) -m ruff format .

types:
	$(PYTHON) -m mypy

test:
	$(PYTHON) -m pytest

slow:
	PYTHON=$(PYTHON) .ci/full

mutants:
	$(PYTHON) tests/mutants/run.py

kernels:
	PYTHON=$(PYTHON) .ci/kernels

lowest:
	PYTHON=$(PYTHON) .ci/lowest

docs:
	$(PYTHON) -m sphinx -W --keep-going docs docs/_build/html

package:
	$(PYTHON) -m pytest -m slow -n 0 tests/test_packaging.py

clean:
	rm -rf build dist docs/_build docs/auto_examples docs/generated
