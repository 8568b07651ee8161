# make demo  sets everything up and runs the whole chain on the embedded data (preset: PRESET=default)
# make test  sets everything up and runs the checks and tests
# make hands OUT=folder N=50 SET=test-like  and  make scenes OUT=folder N=100  render more pictures (docs/data.md)
# make benchmarks  measures this machine: training, inference, the paper's preset (leave it alone meanwhile)
# make registry  lists the versions of the ensemble;  make rollback BECAUSE='...'  puts the one before in use again
# make ui    opens the Dagster UI (and MLflow's) on the same storage
#
# TORCH_INDEX=https://download.pytorch.org/whl/cpu makes the installation smaller on machines without a GPU.

PYTHON ?= python3
PRESET ?= default
TORCH_INDEX ?=
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
REQUIREMENTS := -e .[vision,sim,mcap] --group orchestration --group dev
export DELTASAFE_PRESET := $(PRESET)

.PHONY: registry rollback hands scenes surroundings demo test ui check lock clean record study planner-study safety-study tracking-study benchmarks

demo: $(STAMP)
	$(BIN)/python -m pipelines.demo

# the demo, and its figures written to docs/results
record: $(STAMP)
	$(BIN)/python -m pipelines.demo --record docs/results/$(PRESET).json

# Tables I to III, Fig. 4 and the ablation: hours; an interrupted study goes on where it was
study: $(STAMP)
	$(BIN)/python -m pipelines.study --record docs/results/perception.json

# Fig. 5 and Fig. 6: minutes
planner-study: $(STAMP)
	$(BIN)/python -m pipelines.planner_study --record docs/results/planner_study.json

# thousands of executed motions, an hour; after `make demo`, whose ensemble it takes.
# SCENES="DIR ..." names folders of scenes (docs/data.md), EXECUTIONS=N how many motions
safety-study: $(STAMP)
	$(BIN)/python -m pipelines.safety_study --record docs/results/safety.json \
	  $(if $(SCENES),--scenes $(SCENES)) $(if $(EXECUTIONS),--executions $(EXECUTIONS))

# the tracking bound gamma(v) of the simulated arm, a quarter of an hour
tracking-study: $(STAMP)
	$(BIN)/python -m pipelines.tracking_study --record docs/results/safety.json

# each in turns with what one would write first; half an hour, on a machine with nothing else to do
benchmarks: $(STAMP)
	$(BIN)/python -m benchmarks.inference --record docs/results/benchmarks_perception.json
	$(BIN)/python -m benchmarks.training --record docs/results/benchmarks_perception.json
	$(BIN)/python -m benchmarks.paper_preset --record docs/results/paper_preset.json
	$(BIN)/python -m benchmarks.planner --record docs/results/planner.json

test: $(STAMP) check
	$(BIN)/python -m pytest -n 2 --dist loadfile

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	DAGSTER_HOME= $(BIN)/dg check defs
	DAGSTER_HOME= $(BIN)/dagster definitions validate -w workspace.yaml

ui: $(STAMP)
	$(BIN)/python -m pipelines.ui

registry: $(STAMP)
	$(BIN)/python -m pipelines.registry list

BECAUSE ?= no reason given
rollback: $(STAMP)
	$(BIN)/python -m pipelines.registry rollback --because '$(BECAUSE)'

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
	  { echo "deltasafe needs Python 3.11 or newer; set it with: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "$(PYTHON) lacks the venv module; on Debian and Ubuntu: apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@echo "Installing (about 4 minutes and 7 GB with the default build of torch) ..."
	@if command -v uv >/dev/null 2>&1; then \
	  VIRTUAL_ENV=$(VENV) uv pip install -q $(REQUIREMENTS) -c constraints.txt $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)); \
	else \
	  $(BIN)/python -m pip install -q --upgrade 'pip>=25.1' && \
	  $(BIN)/python -m pip install -q $(REQUIREMENTS) -c constraints.txt $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)); \
	fi
	@touch $(STAMP)

# constraints.txt: newest versions that install together, free of hosts
lock:
	uv pip compile --universal --no-emit-index-url --no-header --no-annotate --python-version 3.11 \
	  --extra vision --extra sim --extra mcap --group orchestration --group dev --group generator pyproject.toml -o constraints.txt

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
	@if command -v uv >/dev/null 2>&1; then \
	  VIRTUAL_ENV=$(VENV) uv pip install -q --group generator -c constraints.txt; \
	else \
	  $(BIN)/python -m pip install -q --group generator -c constraints.txt; \
	fi
	@touch $(RENDERER)

clean:
	rm -rf $(VENV)
