# make demo      set up, validate the example scene and print the address of its live display
# make test      set up and run the fast tests
# make test-all  also run the slow tests and the comparison with a lens design program
# make docs      build the site: build/docs/index.html
# make reports-check  list committed results whose code has changed, and sentences that quote them
# make test-docs run every command and code block of the documentation, in order
# make clean     remove everything that this file creates
#
# Everything is installed in .venv. The files .venv/.* mark finished steps, so a second run starts at once.

PYTHON3 ?= python3
VENV := .venv
BIN := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# A container's root user has no other packages that pip could disturb.
export PIP_ROOT_USER_ACTION := ignore
# Containers forbid to keep compiled modules; each of hundreds of processes would compile all again.
unexport PYTHONDONTWRITEBYTECODE

# Workers begin with contiguous thirds, whose tests share fixtures, and take tests from slower ones.
# With `loadfile`, a crashed worker's file is never finished, and the run does not end.
PARALLEL := -n 3 --dist worksteal
# Slow tests take up to minutes each: the next goes to the worker that is free.
PARALLEL_SLOW := -n 3 --dist load --maxschedchunk 1

.DEFAULT_GOAL := test
.PHONY: demo test test-all checks fast docs test-docs reports-check clean

demo: $(VENV)/.installed
	@$(BIN)/inim demo -o out/amphora

# Without a cache, mypy occupies one core for 13 to 30 seconds, so the tests start at the same time.
test: $(VENV)/.installed-test
	@$(MAKE) --no-print-directory --jobs 2 checks fast

test-all: $(VENV)/.installed-oracle
	@$(MAKE) --no-print-directory test
	@$(BIN)/python -m pytest -m slow $(PARALLEL_SLOW)

fast: $(VENV)/.installed-test
	@$(BIN)/python -m pytest tests -m "not slow" $(PARALLEL)

checks: $(VENV)/.installed-test
	@echo "ruff, mypy, lint-imports, plain English"
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --check --quiet . || { echo "to format, run: $(BIN)/ruff format ."; exit 1; }
	@$(BIN)/mypy --no-error-summary
	@$(BIN)/python -m tests.plain_english
	@output=$$($(BIN)/lint-imports 2>&1) || { printf '%s\n' "$$output"; exit 1; }

docs: $(VENV)/.installed-docs
	@$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet --jobs auto docs build/docs
	@echo "site: build/docs/index.html"

test-docs: $(VENV)/.installed-test
	@$(BIN)/python -m tests.documents

reports-check: $(VENV)/.installed-test
	@$(BIN)/python -m tests.reports_check

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find inim tests -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.installed: $(VENV)/.made pyproject.toml
	@echo "installing inim and its dependencies into $(VENV) (about 1 GB, one or two minutes)"
	@$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.installed-test: $(VENV)/.made pyproject.toml
	@echo "installing inim and its test tools into $(VENV) (about 500 MB, a few minutes)"
	@$(BIN)/python -m pip install --quiet --editable '.[test]'
	@touch $@ $(VENV)/.installed $(VENV)/.installed-docs

$(VENV)/.installed-docs: $(VENV)/.made pyproject.toml
	@echo "installing inim and the tools for its site into $(VENV) (about 100 MB, one or two minutes)"
	@$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@

$(VENV)/.installed-oracle: $(VENV)/.installed-test
	@echo "installing optiland into $(VENV) (about 700 MB, a few minutes)"
	@$(BIN)/python -m pip install --quiet --editable '.[oracle]'
	@touch $@

$(VENV)/.made:
	@$(PYTHON3) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "Python 3.10 or newer is needed; to name one: make PYTHON3=/path/to/python3"; exit 2; }
	@$(PYTHON3) -c 'import ensurepip' 2>/dev/null || { $(get_venv); }
	@echo "creating $(VENV)"
	@$(PYTHON3) -m venv --clear $(VENV)
	@touch $@

# Debian and Ubuntu ship Python without what makes virtual environments.
define get_venv
if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
    echo "installing python3-venv"; \
    said=$$(apt-get update -qq 2>&1 && DEBIAN_FRONTEND=noninteractive \
      apt-get install -y -qq --no-install-recommends python3-venv 2>&1) || \
      { printf '%s\n' "$$said"; exit 2; }; \
  else echo "Python cannot make virtual environments here; type: sudo apt-get install python3-venv"; exit 2; fi
endef
