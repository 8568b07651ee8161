# `make help` lists the commands. These variables apply to all of them:
#   PRESET=smoke          preset of the pipeline (docs/reference/settings.md)
#   PYTHON=PATH           interpreter for the environment; without it: python3.11, then python3, then uv
#   TORCH_INDEX=URL       package index with smaller builds of torch, e.g. https://download.pytorch.org/whl/cpu
#   COMPILE_PYBULLET=1    compile PyBullet where it has no wheel

.DEFAULT_GOAL := help
PRESET ?= default
PYTHON ?=
TORCH_INDEX ?=
COMPILE_PYBULLET ?=
VENV := .venv
BIN := $(VENV)/bin
# Each stamp marks a finished installation into $(VENV).
STAMP := $(VENV)/.installed
BROWSER := $(VENV)/.browser-installed
AUDITOR := $(VENV)/audit/.installed
TEAM := $(VENV)/.team-installed
SERVICES := $(VENV)/.services-installed
CLUSTER := $(VENV)/.cluster-installed
SITE := $(VENV)/.docs-installed
RENDERER := $(VENV)/.renderer-installed
REQUIREMENTS := -e .[vision,sim,mcap,ros,heic,signing] --group orchestration --group dev
export DELTASAFE_PRESET := $(PRESET)

# An option of a folder that was given to make itself: a variable of the environment with that name is another program's.
own = $(if $(findstring command,$(origin $(1))),--$(2) '$($(1))')

.PHONY: help demo test check docs ui wheel clean lock results record study planner-study safety-study tracking-study benchmarks faults scale operation-record week pictures sbom audit registry rollback prune examples surroundings hands scenes team services-test lint-deploy browser-test

help: ## list the commands
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-18s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(STAMP) ## set up, then run the whole pipeline; HANDS=DIR TEST=DIR SCENES=DIR BACKGROUNDS=DIR replace embedded data
	$(BIN)/python -m pipelines.commands.demo $(call own,HANDS,hands) $(call own,TEST,test) $(call own,SCENES,scenes) $(call own,BACKGROUNDS,backgrounds)

# Long test files come first and keep their order: sorted by number of tests, one core would wait for the last file.
test: $(STAMP) check ## set up, then run the checks and the tests
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --ignore tests/browser --ignore tests/services

check: $(STAMP) ## run the checks alone: lint, types, import contracts, definitions
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	DAGSTER_HOME= $(BIN)/dg check defs
	DAGSTER_HOME= $(BIN)/dagster definitions validate -w workspace.yaml

# A broken link or reference fails.
docs: $(SITE) ## build the documentation site into site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

ui: $(STAMP) ## open the Dagster UI and the MLflow UI (docs/how-to/ui.md)
	$(BIN)/python -m pipelines.commands.ui

registry: $(STAMP) ## list the versions of the ensemble
	$(BIN)/python -m pipelines.commands.registry list

BECAUSE ?= no reason given
rollback: $(STAMP) ## use the previous ensemble again; BECAUSE='REASON'
	$(BIN)/python -m pipelines.commands.registry rollback --because '$(BECAUSE)'

prune: $(STAMP) ## show the disk use of the home and what may be deleted; DELETE=1 deletes it
	$(BIN)/python -m pipelines.commands.prune $(if $(DELETE),--delete)

SET ?= test-like
SEED ?= 0
hands: $(RENDERER) ## render labeled hand images; OUT=DIR N=50 SET=test-like SEED=0 (docs/how-to/render-data.md)
	$(BIN)/python -m generator hands --out '$(OUT)' --count '$(N)' --set $(SET) --seed $(SEED) $(OPTIONS)

scenes: $(RENDERER) ## render logged scenes; OUT=DIR N=100 SEED=0 (docs/how-to/render-data.md)
	$(BIN)/python -m generator scenes --out '$(OUT)' --count '$(N)' --seed $(SEED) $(OPTIONS)

surroundings: $(RENDERER) ## download lights and textures for rendering; without them they are procedural
	$(BIN)/python -m generator fetch

record: $(STAMP) ## run the demo and write its figures to docs/results
	$(BIN)/python -m pipelines.commands.demo --record docs/results/$(PRESET).json

study: $(STAMP) ## Tables I to III, Fig. 4 and the ablation; hours, resumes after an interruption
	$(BIN)/python -m pipelines.commands.perception_study --record docs/results/perception.json

planner-study: $(STAMP) ## Fig. 5 and Fig. 6; minutes
	$(BIN)/python -m pipelines.commands.planner_study --record docs/results/planner.json

safety-study: $(STAMP) ## thousands of executed motions, after the demo; 1 h, SCENES="DIR ..." EXECUTIONS=N
	$(BIN)/python -m pipelines.commands.safety_study --record docs/results/safety.json \
	  $(if $(SCENES),--scenes $(SCENES)) $(if $(EXECUTIONS),--executions $(EXECUTIONS))

tracking-study: $(STAMP) ## identify the tracking bound gamma(v) of the simulated arm; 15 min
	$(BIN)/python -m pipelines.commands.tracking_study --record docs/results/safety.json

benchmarks: $(STAMP) ## measure training, inference, planner and the paper preset on an idle machine; 30 min
	$(BIN)/python -m evidence.benchmarks.inference --record docs/results/perception.json
	$(BIN)/python -m evidence.benchmarks.training --record docs/results/perception.json
	$(BIN)/python -m evidence.benchmarks.paper_preset --record docs/results/paper_preset.json
	$(BIN)/python -m evidence.benchmarks.planner --record docs/results/planner.json

faults: $(STAMP) ## test the promises of docs/explanation/reliability.md with thousands of injected faults; minutes
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

scale: $(CLUSTER) ## compare a Ray cluster of two hosts (network namespaces) with one machine; 15 min (docs/how-to/cluster.md)
	$(BIN)/python -m evidence.scale --record docs/results/scale.json

operation-record: $(STAMP) ## measure the cost of orchestration, retraining and rollback, after the demo
	$(BIN)/python -m evidence.operation share --record docs/results/operation.json
	$(BIN)/python -m evidence.operation tests --record docs/results/operation.json
	$(BIN)/python -m evidence.operation faults --record docs/results/operation.json

WEEK ?= 200
week: $(STAMP) ## operate a home in fast motion: runs, kills, decisions by hand, a full disk; hours, WEEK=N runs, resumes
	$(BIN)/python -m evidence.week --home .deltasafe/week --runs $(WEEK) --record docs/results/operation.json

results: $(STAMP) ## write docs/results/README.md and the figures of README and docs/ from the records
	$(BIN)/python -m evidence.results_page

pictures: $(BROWSER) ## take the screenshots of the UI for the README
	$(BIN)/python -m tests.browser.pictures --out docs/pictures

browser-test: $(BROWSER) ## test the UI in Chromium (docs/how-to/ui.md); SCREENSHOTS=DIR RECORD=FILE
	DELTASAFE_SCREENSHOTS='$(SCREENSHOTS)' $(BIN)/python -m evidence.operation browser $(if $(RECORD),--record $(RECORD))

wheel: $(STAMP) ## build the library into dist/
	$(BIN)/python -m hatchling build -t wheel -d dist

examples: $(STAMP) ## load the ensemble in three new environments (7 GB in examples/); ENSEMBLE=DIR RECORD=FILE
	$(BIN)/python -m evidence.consumers --torch-index '$(TORCH_INDEX)' \
	  $(if $(ENSEMBLE),--ensemble '$(ENSEMBLE)') $(if $(RECORD),--record $(RECORD))

team: $(TEAM) ## install clients of PostgreSQL and of object stores (docs/how-to/team.md)

services-test: $(SERVICES) lint-deploy ## test with a local PostgreSQL server and a local object store
	@command -v initdb >/dev/null || ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 || \
	  { echo "PostgreSQL is not installed; on Debian and Ubuntu: apt install postgresql"; exit 1; }
	$(BIN)/python -m pytest tests/services

lint-deploy: $(SERVICES) ## lint the files in deploy/; needs no container engine
	$(BIN)/hadolint deploy/Containerfile
	$(BIN)/yamllint --strict -d '{extends: default, rules: {line-length: {max: 140}, document-start: disable, braces: {max-spaces-inside: 0}}}' deploy
	$(BIN)/check-jsonschema --builtin-schema vendor.compose-spec deploy/compose.yaml

sbom: $(STAMP) $(AUDITOR) ## write the installed packages to dist/sbom.json (CycloneDX)
	$(BIN)/python -m evidence.faults.dependencies --sbom-alone

audit: $(STAMP) $(AUDITOR) ## write the SBOM and check it for known vulnerabilities; RECORD=FILE
	$(BIN)/python -m evidence.faults.dependencies $(if $(RECORD),--record $(RECORD))

lock: ## renew constraints.txt with uv: the newest versions that install together
	uv pip compile --universal --no-emit-index-url --no-header --no-annotate --python-version 3.11 \
	  --extra vision --extra sim --extra mcap --extra ros --extra heic --extra signing --extra ray --group orchestration --group dev --group generator --group browser --group services --group kubernetes --group audit --group cluster --group docs pyproject.toml -o constraints.txt

clean: ## delete the environment
	rm -rf $(VENV)

# --- Installation -----------------------------------------------------------------------------------------------------

# Installs the packages $(2) into the environment $(1), with uv if it is on PATH.
define install
@if command -v uv >/dev/null 2>&1; then \
	  VIRTUAL_ENV=$(1) uv pip install -q $(2) -c constraints.txt; \
	else \
	  $(1)/bin/python -m pip install -q --upgrade 'pip>=25.1' && \
	  $(1)/bin/python -m pip install -q $(2) -c constraints.txt; \
	fi
endef

$(STAMP): pyproject.toml constraints.txt
	@PYTHON='$(PYTHON)' COMPILE_PYBULLET='$(COMPILE_PYBULLET)' sh create_venv.sh $(VENV) '$(MAKECMDGOALS)'
	@echo "Installing (about 4 minutes and 7 GB with the default build of torch) ..."
	$(call install,$(VENV),$(REQUIREMENTS) $(if $(COMPILE_PYBULLET),,--only-binary pybullet) $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)))
	@touch $(STAMP)

$(RENDERER): $(STAMP)
	$(call install,$(VENV),--group generator)
	@touch $(RENDERER)

$(TEAM): $(STAMP)
	$(call install,$(VENV),--group team)
	@touch $(TEAM)

$(SERVICES): $(STAMP)
	$(call install,$(VENV),--group services)
	@touch $(SERVICES)

$(SITE): $(STAMP)
	$(call install,$(VENV),--group docs)
	@touch $(SITE)

$(BROWSER): $(STAMP)
	$(call install,$(VENV),--group browser)
	@touch $(BROWSER)

$(AUDITOR): $(STAMP)
	$(BIN)/python -m venv $(VENV)/audit
	$(call install,$(VENV)/audit,--group audit)
	@touch $(AUDITOR)

$(CLUSTER): $(STAMP)
	$(call install,$(VENV),--group cluster)
	@touch $(CLUSTER)
