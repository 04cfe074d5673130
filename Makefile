# The commands of CI, one by one, for an environment in which `pip install -e ".[test,docs]"` was run.
.PHONY: lint types contracts test test-fast full

lint:        ## style and common mistakes
	ruff check .

types:       ## static types
	mypy

contracts:   ## which package, and which room of it, may import which
	lint-imports

test:        ## the tests, without the longest (tests/full.txt)
	python -m pytest

test-fast:   ## the tests that are not marked slow
	python -m pytest -m "not slow"

full:        ## everything, in an environment of its own; about an hour
	.ci/run full
