# Two commands for a newcomer: `make demo` and `make test`. Needs Python 3.11 or newer, and make; nothing else.

PYTHON ?= python3
VENV ?= .venv
EXTRAS ?= test,studio
FUZZ ?= 10000
KILLS ?= 200
SEED ?= 10031
# The versions that everything was tested with; CONSTRAINTS= takes the newest that pyproject.toml allows.
CONSTRAINTS ?= constraints.txt
WORKERS ?= auto
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip -qq --disable-pip-version-check --no-input

# An environment is good as long as pyproject.toml and the constraints say the same: its marker carries a hash of the content, not a date.
STATE := $(shell $(PYTHON) -c "import hashlib; print(hashlib.sha256(b''.join(open(f, 'rb').read() for f in 'pyproject.toml $(wildcard $(CONSTRAINTS))'.split())).hexdigest()[:12])")
comma := ,
# A worker on every core; one that has nothing left takes tests from the other. What they start reads kept bytecode.
PARALLEL = -n $(WORKERS) --dist worksteal
MARK = $(VENV)/.installed-$(STATE)-$(subst $(comma),-,$(1))

.PHONY: help demo test quick studies faults lint fuzz hidden coverage bench paper lock audit docs clean

help:
	@echo "make demo    install into $(VENV), run the main job on the embedded machine, print where the report is"
	@echo "make test    install with the test tools, run every test (make quick: without the slow ones)"
	@echo "make lint    ruff, imports, types               make fuzz    $(FUZZ) bad inputs of each kind, $(KILLS) kills"
	@echo "make studies figures over many records, a table make faults  put faults into the code, count those found"
	@echo "make bench   measure speed                     make hidden  find effects hidden in records"
	@echo "make paper   sweep what makes Table II          make coverage  count how often intervals hold the truth"
	@echo "make audit   look for known vulnerabilities     make lock    take the newest versions"
	@echo "make docs    build docs/_build/html            make clean   remove $(VENV) and everything built"

demo: $(call MARK,run)
	@$(BIN)/emps-design demo --out emps-design-demo.html

test: $(call MARK,$(EXTRAS))
	@env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest $(PARALLEL)

quick: $(call MARK,$(EXTRAS))
	@env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest $(PARALLEL) -m "not slow and not study and not browser"

studies: $(call MARK,$(EXTRAS))
	@env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m study

faults: $(call MARK,$(EXTRAS))
	@$(BIN)/python -m tests.faults

lint: $(call MARK,$(EXTRAS))
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports
	@$(BIN)/mypy emps_design .ci/typed_by_a_user.py

fuzz: $(call MARK,$(EXTRAS))
	@EMPS_DESIGN_FUZZ=$(FUZZ) $(BIN)/python -m pytest --timeout 36000 tests/property
	@$(BIN)/python -m tests.kills $(KILLS)

hidden: $(call MARK,$(EXTRAS))
	@for set in "all" "all --no-laps" "several --count 40" "beside --count 24" "unknown --count 24" "small --count 24" \
		"healthy --count 200"; do $(BIN)/python -m tests.hidden --seed $(SEED) --cases $$set || exit 1; done

coverage: $(call MARK,$(EXTRAS))
	@$(BIN)/python -m benchmarks.coverage

# Commands as they start for a user: with the bytecode that Python keeps.
bench: $(call MARK,$(EXTRAS))
	@env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m benchmarks

paper: $(call MARK,$(EXTRAS))
	@$(BIN)/python -m benchmarks.paper

# Every extra at its newest, in an environment of its own; then run everything, and commit the file.
lock:
	@$(PYTHON) -m venv build/lock
	@build/lock/bin/python -m pip -qq --disable-pip-version-check --no-input install -e ".[audit,browser,cluster,docs,studio,test]"
	@{ echo "# Made by make lock: the versions that everything was tested with."; build/lock/bin/python -m pip --disable-pip-version-check freeze --exclude-editable; } > build/constraints.txt
	@mv build/constraints.txt constraints.txt
	@echo constraints.txt

audit: $(call MARK,audit)
	@$(BIN)/python .ci/audit.py constraints.txt

docs: $(call MARK,docs)
	@$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@test -f docs/_build/html/index.html || { echo "make docs: something ended the build before it wrote a page" >&2; exit 1; }
	@echo "docs/_build/html/index.html"

clean:
	rm -rf $(VENV) build dist docs/_build docs/gallery .pytest_cache .ruff_cache .mypy_cache .hypothesis .import_linter_cache

$(BIN)/python:
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed, this is ' + sys.version.split()[0] + '; try make PYTHON=python3.12')"
	@echo "making $(VENV)" >&2
	@$(PYTHON) -m venv $(VENV)

# The package is installed in place, so an edited source needs no new installation.
$(call MARK,run): | $(BIN)/python
	@echo "installing emps-design into $(VENV) (a minute or two, once)" >&2
	@$(PIP) install $(addprefix -c ,$(CONSTRAINTS)) -e .
	@touch $@

$(VENV)/.installed-$(STATE)-%: | $(BIN)/python
	@echo "installing emps-design with the extras $* into $(VENV) (a minute or two, once)" >&2
	@$(PIP) install $(addprefix -c ,$(CONSTRAINTS)) -e ".[$(subst -,$(comma),$*)]"
	@touch $@ $(call MARK,run)
