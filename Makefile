# make demo  sets everything up and runs the whole chain on the embedded data (preset: PRESET=default)
# make test  sets everything up and runs the checks and tests
# make hands OUT=folder N=50 SET=test-like  and  make scenes OUT=folder N=100  render more pictures (docs/data.md)
# make scale  does the same work on a Ray cluster of two simulated hosts and on one machine (docs/scaling.md)
# make benchmarks  times training, inference, the paper preset and the planner on this machine, which must be idle
# make faults  injects faults by the thousand: bad input, changed bytes, kills (docs/reliability.md)
# make audit   asks whether anything installed has a known vulnerability;  make sbom  writes what is installed to dist/
# make registry  lists the versions of the ensemble;  make rollback BECAUSE='...'  puts the one before in use again
# make wheel  builds the library alone into dist/;  make examples  pulls the ensemble in use into environments made from it
# make team  adds what several machines on the same records need: PostgreSQL, an object store (docs/deployment.md)
# make ui    opens the Dagster UI (and MLflow's) on the same storage
#
# TORCH_INDEX=https://download.pytorch.org/whl/cpu makes the installation smaller on machines without a GPU.

PYTHON ?= python3
PRESET ?= default
TORCH_INDEX ?=
VENV := .venv
BROWSER := $(VENV)/.browser-installed
AUDITOR := $(VENV)/audit/.installed
TEAM := $(VENV)/.team-installed
SERVICES := $(VENV)/.services-installed
CLUSTER := $(VENV)/.cluster-installed
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
REQUIREMENTS := -e .[vision,sim,mcap,signing] --group orchestration --group dev
export DELTASAFE_PRESET := $(PRESET)

# make results  writes docs/results/README.md from the records beside it
.PHONY: results scale team services-test lint-deploy browser-test pictures operation-record wheel examples registry rollback hands scenes surroundings demo test ui check lock clean record study planner-study safety-study tracking-study benchmarks faults sbom audit

demo: $(STAMP)
	$(BIN)/python -m pipelines.commands.demo

# the demo, and its figures written to docs/results
record: $(STAMP)
	$(BIN)/python -m pipelines.commands.demo --record docs/results/$(PRESET).json

# Tables I to III, Fig. 4 and the ablation: hours; an interrupted study goes on where it was
study: $(STAMP)
	$(BIN)/python -m pipelines.commands.perception_study --record docs/results/perception.json

# Fig. 5 and Fig. 6: minutes
planner-study: $(STAMP)
	$(BIN)/python -m pipelines.commands.planner_study --record docs/results/planner.json

# thousands of executed motions, an hour; after `make demo`, whose ensemble it takes.
# SCENES="DIR ..." names folders of scenes (docs/data.md), EXECUTIONS=N how many motions
safety-study: $(STAMP)
	$(BIN)/python -m pipelines.commands.safety_study --record docs/results/safety.json \
	  $(if $(SCENES),--scenes $(SCENES)) $(if $(EXECUTIONS),--executions $(EXECUTIONS))

# the tracking bound gamma(v) of the simulated arm, a quarter of an hour
tracking-study: $(STAMP)
	$(BIN)/python -m pipelines.commands.tracking_study --record docs/results/safety.json

# the smoke chain and a thousand plans on a Ray cluster and without one, with killed hosts; a quarter of an hour
scale: $(CLUSTER)
	$(BIN)/python -m evidence.scale --record docs/results/scale.json

# each in turn with a baseline; half an hour on an idle machine
benchmarks: $(STAMP)
	$(BIN)/python -m evidence.benchmarks.inference --record docs/results/perception.json
	$(BIN)/python -m evidence.benchmarks.training --record docs/results/perception.json
	$(BIN)/python -m evidence.benchmarks.paper_preset --record docs/results/paper_preset.json
	$(BIN)/python -m evidence.benchmarks.planner --record docs/results/planner.json

# docs/results/README.md: recorded figures beside their targets
results: $(STAMP)
	$(BIN)/python -m evidence.results_page

# each command fails if a promise of docs/reliability.md does not hold
faults: $(STAMP)
	$(BIN)/python -m evidence.faults.inputs --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.flips --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.pickles --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.digests --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.properties --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.kills --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.dagster_kills --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.denials --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.races --record docs/results/reliability.json
	$(BIN)/python -m evidence.faults.soak --record docs/results/reliability.json

# dist/sbom.json: what is installed, for a scanner (CycloneDX)
sbom: $(STAMP) $(AUDITOR)
	$(BIN)/python -m evidence.faults.dependencies --sbom-alone

# the SBOM, and pip-audit where a database of vulnerabilities can be reached; says so where none can
audit: $(STAMP) $(AUDITOR)
	$(BIN)/python -m evidence.faults.dependencies $(if $(RECORD),--record $(RECORD))

# files in their own order, long ones first: reordered by number of tests, one core would wait for the last of them
test: $(STAMP) check
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --ignore tests/browser --ignore tests/services

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	DAGSTER_HOME= $(BIN)/dg check defs
	DAGSTER_HOME= $(BIN)/dagster definitions validate -w workspace.yaml

ui: $(STAMP)
	$(BIN)/python -m pipelines.commands.ui

registry: $(STAMP)
	$(BIN)/python -m pipelines.tracking.registry list

BECAUSE ?= no reason given
rollback: $(STAMP)
	$(BIN)/python -m pipelines.tracking.registry rollback --because '$(BECAUSE)'

wheel: $(STAMP)
	$(BIN)/python -m hatchling build -t wheel -d dist

# three ways of pulling the ensemble, in environments of their own (7 GB below examples/ the first time);
# ENSEMBLE=DIR names another than the one in use, RECORD=FILE merges the figures into a record
examples: $(STAMP)
	$(BIN)/python -m evidence.consumers --torch-index '$(TORCH_INDEX)' \
	  $(if $(ENSEMBLE),--ensemble '$(ENSEMBLE)') $(if $(RECORD),--record $(RECORD))

team: $(TEAM)

# PostgreSQL and an object store for real, on loopback, and the commands of deploy/ without containers
services-test: $(SERVICES) lint-deploy
	@command -v initdb >/dev/null || ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 || \
	  { echo "PostgreSQL is not installed; on Debian and Ubuntu: apt install postgresql"; exit 1; }
	$(BIN)/python -m pytest tests/services

# deploy/: what can be checked without a container engine
lint-deploy: $(SERVICES)
	$(BIN)/hadolint deploy/Containerfile
	$(BIN)/yamllint --strict -d '{extends: default, rules: {line-length: {max: 140}, document-start: disable, braces: {max-spaces-inside: 0}}}' deploy
	$(BIN)/check-jsonschema --builtin-schema vendor.compose-spec deploy/compose.yaml

# the UI, used by clicks; a Chromium has to be there (docs/ui.md). SCREENSHOTS=DIR keeps what it saw, RECORD=FILE the outcome
browser-test: $(BROWSER)
	DELTASAFE_SCREENSHOTS='$(SCREENSHOTS)' $(BIN)/python -m evidence.operation browser $(if $(RECORD),--record $(RECORD))

# the UI for the README, as it shows what the home holds
pictures: $(BROWSER)
	$(BIN)/python -m tests.browser.pictures --out docs/pictures

# after `make demo`: the time that orchestration took; new images, a worse ensemble and a rollback, by their tests
operation-record: $(STAMP)
	$(BIN)/python -m evidence.operation share --record docs/results/operation.json
	$(BIN)/python -m evidence.operation tests --record docs/results/operation.json

# into the environment $(1), by uv where it is there
define install
@if command -v uv >/dev/null 2>&1; then \
	  VIRTUAL_ENV=$(1) uv pip install -q $(2) -c constraints.txt; \
	else \
	  $(1)/bin/python -m pip install -q --upgrade 'pip>=25.1' && \
	  $(1)/bin/python -m pip install -q $(2) -c constraints.txt; \
	fi
endef

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
	  { echo "deltasafe needs Python 3.11 or newer; set it with: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "$(PYTHON) lacks the venv module; on Debian and Ubuntu: apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@echo "Installing (about 4 minutes and 7 GB with the default build of torch) ..."
	$(call install,$(VENV),$(REQUIREMENTS) $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)))
	@touch $(STAMP)

# constraints.txt: newest versions that install together, free of hosts
lock:
	uv pip compile --universal --no-emit-index-url --no-header --no-annotate --python-version 3.11 \
	  --extra vision --extra sim --extra mcap --extra signing --extra ray --group orchestration --group dev --group generator --group browser --group services --group kubernetes --group audit --group cluster pyproject.toml -o constraints.txt

# more rendered hands and scenes; `make surroundings` fetches light and surfaces once, without it they are procedural
RENDERER := $(VENV)/.renderer-installed
SET ?= test-like
SEED ?= 0

surroundings: $(RENDERER)
	$(BIN)/python -m generator fetch

hands: $(RENDERER)
	$(BIN)/python -m generator hands --out '$(OUT)' --count '$(N)' --set $(SET) --seed $(SEED) $(OPTIONS)

scenes: $(RENDERER)
	$(BIN)/python -m generator scenes --out '$(OUT)' --count '$(N)' --seed $(SEED) $(OPTIONS)

$(RENDERER): $(STAMP)
	$(call install,$(VENV),--group generator)
	@touch $(RENDERER)

$(TEAM): $(STAMP)
	$(call install,$(VENV),--group team)
	@touch $(TEAM)

$(SERVICES): $(STAMP)
	$(call install,$(VENV),--group services)
	@touch $(SERVICES)

$(BROWSER): $(STAMP)
	$(call install,$(VENV),--group browser)
	@touch $(BROWSER)

$(AUDITOR): $(STAMP)
	$(PYTHON) -m venv $(VENV)/audit
	$(call install,$(VENV)/audit,--group audit)
	@touch $(AUDITOR)

$(CLUSTER): $(STAMP)
	$(call install,$(VENV),--group cluster)
	@touch $(CLUSTER)

clean:
	rm -rf $(VENV)
