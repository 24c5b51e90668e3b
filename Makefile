# The two commands of the README are `make demo` and `make serve`; everything else is for those who change the code.
PYTHON ?= python3
# The newest release that we test with; any torch that fits your machine will do: make install TORCH=torch
TORCH ?= torch==2.13.0
BIN := .venv/bin
# Text is UTF-8 whatever the locale, and whatever a library does to it in the process.
export PYTHONUTF8 := 1

.PHONY: install demo serve test test-all test-hostile check audit format openapi examples bench bench-hydraulics bench-field bench-cut bench-bodies bench-load clean

install: .venv/.installed

.venv/.installed: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet "$(TORCH)"
	$(BIN)/pip install --quiet --editable '.[cfd,dev]'
	touch $@

demo: install
	$(BIN)/python examples/demo.py

serve: install
	$(BIN)/dualms serve

test: install
	$(BIN)/python -m pytest -n 2 --dist loadfile

# Everything that this machine can run: slow tests, and those that need OpenFOAM or Chromium where they are installed.
test-all: install
	$(BIN)/python -m pytest -m "not gpu"

check: install
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -n 2 --dist loadfile

# Known vulnerabilities of what is installed; asks the public list of advisories, so it is no part of the tests.
audit: install
	$(BIN)/pip list --format freeze --exclude-editable | sed 's/+.*//' > .audit.txt
	$(BIN)/pip-audit --strict --no-deps --disable-pip --progress-spinner off --requirement .audit.txt

# The long tests of the service: files made to break readers, generated requests, kill -9.
test-hostile: install
	$(BIN)/python -m pytest -m slow tests/worker/test_hostile.py tests/service/test_fuzz.py tests/service/test_serve.py

format: install
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

openapi: install
	$(BIN)/python -m service.openapi

examples: install
	$(BIN)/python examples/make_examples.py

bench: bench-cut bench-field

bench-cut: install
	$(BIN)/python benchmarks/cut.py

bench-field: install
	$(BIN)/python benchmarks/field.py

# One mode of the field's benchmarks: make bench-field-minimal DOMAIN=examples/u_bend.stl SPEC=examples/u_bend.json
DOMAIN ?= examples/u_bend.stl
SPEC ?= examples/u_bend.json
bench-field-%: install
	$(BIN)/python benchmarks/field.py $* $(DOMAIN) $(SPEC)

# Seven envelopes at grid 256; the authors' U-shape by argument: make bench-bodies U_SHAPE="--u-shape FILE"
U_SHAPE ?=
bench-bodies: install
	$(BIN)/python benchmarks/bodies.py $(U_SHAPE)

bench-load: install
	$(BIN)/python -m benchmarks.load --out benchmarks/results/load.json

# The envelope of the paper's authors is theirs: make bench-hydraulics U_SHAPE=path/to/u_shape.obj
WHOLE := $(BIN)/python benchmarks/hydraulics.py whole
bench-hydraulics: install
ifdef U_SHAPE
	$(WHOLE) --name u_shape --domain $(U_SHAPE) --spec benchmarks/u_shape.json --longest-side-m 0.14 --trend 64 96 128
endif
	$(WHOLE) --name multi_bend --domain examples/multi_bend.stl --spec examples/multi_bend.json
	$(WHOLE) --name zigzag --domain examples/zigzag.stl --spec examples/zigzag.json --grid 160

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .import_linter_cache build *.egg-info demo-output
