# `make demo` and `make test` do everything on a machine with only Python 3.12+ and make.
PYTHON ?= $(shell for p in python3.12 python3.13 python3; do \
  $$p -c 'import sys; sys.exit(not (3, 12) <= sys.version_info[:2] < (3, 14))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
# the page's script is checked where npm is; its tests run in a browser, where there is one
SCRIPT = @if npx --yes --package=$(1) $(2) --version >/dev/null 2>&1; then npx --yes --package=$(1) $(2) $(3); \
  else echo "npx has no $(1) here: the page's script is not checked by $(2)"; fi

# the extra of a machine with a GPU
GPU = $(shell nvidia-smi -L >/dev/null 2>&1 && echo '[gpu]')

# uv where it is on the PATH, else pip, which reads dependency groups since 25.1
UV := $(shell command -v uv 2>/dev/null)
VENV = $(if $(UV),$(UV) venv -q --allow-existing --seed --python $(PYTHON),$(PYTHON) -m venv)
INSTALL = $(if $(UV),$(UV) pip install -q --python $(BIN)/python,$(BIN)/pip install -q)

# every Python that is supported and there, a pyenv's too
PYTHONS = $(shell for v in 3.12 3.13; do for p in python$$v $$HOME/.pyenv/versions/$$v*/bin/python; do \
  $$p -c '' 2>/dev/null && echo $$p && break; done; done)

.PHONY: demo baseline kernels shapes test wheel slow slurm lint types docs reference paper points setup clean

demo: setup
	rm -rf results/demo
	PATH="$(BIN):$$PATH" jobs/ci_smoke.sh results/demo tests/data/ci_smoke

baseline: setup  # what the demo is compared with: renew it when results are meant to change, and say so in the commit
	rm -rf tests/data/ci_smoke
	$(BIN)/sweep run study=ci_smoke out=tests/data/ci_smoke
	rm tests/data/ci_smoke/.lock tests/data/ci_smoke/log.txt

test: setup lint types
	XLA_FLAGS=--xla_backend_optimization_level=1 $(BIN)/pytest -n 2  # programs of tests run once: compiling them is what takes long

wheel: setup  # the wheel in an empty environment, run from an empty folder
	jobs/wheel.sh $(or $(PYTHONS),$(PYTHON))

slow: setup
	$(BIN)/pytest -m slow

shapes: setup  # every call of formulas, models, dynamics and controllers checked for the shapes that it promises
	PYTHONPATH=tests $(BIN)/pytest -p shapes tests/formulas tests/models tests/controllers

# needs Debian's slurm-wlm and munge, which the tests start and stop themselves
slurm: setup
	$(BIN)/pytest -m slurm -rs

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(call SCRIPT,prettier@3.10.1,prettier,--check sweep/report/page)

types: setup
	$(BIN)/pyright --threads
	$(call SCRIPT,typescript@5.9,tsc,-p sweep/report/page)

paper: setup  # all that research/ shows: JOBS=14 at once for each GPU with 16 cores; QUICK=--quick on two cores, coarser
	$(BIN)/python jobs/paper.py --jobs $(or $(JOBS),1) $(QUICK)
	$(BIN)/python research/cited.py

kernels: setup  # how large GPU kernels are: renew it when that is meant to change, and say so in the commit; needs ptxas
	$(BIN)/python tests/kernel_counts.py

points: setup  # 20 rollouts of a shipped example, by the commit's hash, end as they did
	$(BIN)/python jobs/check_points.py

docs: setup  # build/site: all pages and the reference, links checked
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q

reference: setup  # docs/reference, which a test compares with the code
	$(BIN)/python docs/reference_pages.py

setup: .venv/.installed

.venv/.installed: pyproject.toml setup.py constraints.txt
	@test -n "$(PYTHON)" || { echo "make: no Python 3.12 or 3.13 on the PATH; set PYTHON=/path/to/python3.12"; exit 1; }
	$(VENV) .venv
	$(if $(UV),,$(INSTALL) 'pip>=25.1')
	$(INSTALL) -c constraints.txt -e '.$(GPU)' --group dev
	@touch $@

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .ruff_cache
