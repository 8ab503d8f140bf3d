# make help lists the commands. Without make: docs/install.md.

PYTHON ?= python3
export PATH := $(CURDIR)/.venv/bin:$(PATH)
REPRO := python -m pipeline.lanes
PIP := .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
CPU_INDEX := https://download.pytorch.org/whl/cpu

# Values go to commands through the environment, as they were typed: neither make nor the shell expands what is in them.
override DATA := $(value DATA)
override NAME := $(value NAME)
override INCLUDE := $(value INCLUDE)
override UP := $(value UP)
override PROFILE := $(value PROFILE)
export DATA NAME INCLUDE UP PROFILE

.PHONY: help repro own demo test check

help:
	@echo 'make repro                          the whole pipeline, default size, then the report'
	@echo 'make repro PROFILE=tiny             the same in work/tiny with profiles/tiny.yaml'
	@echo 'make own DATA=folder NAME=chair     your own shapes, in work/own-chair'
	@echo '         [INCLUDE="Chair_*"] [UP=z]'
	@echo 'make demo                           train what cagesdf view --demo opens'
	@echo 'make test                           the tests; with COVERAGE=1 the lines that they run'
	@echo 'make check                          ruff and mypy'
	@echo 'Each takes TORCH=cpu: on Linux torch without CUDA, which is gigabytes, from an index of its own'

.venv/installed: pyproject.toml constraints.txt
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
ifeq ($(TORCH),cpu)
	$(PIP) --no-deps --index-url $(CPU_INDEX) torch
else
	@.venv/bin/python -c 'import importlib.util, sys; found = importlib.util.find_spec("torch"); \
	sys.platform != "linux" or found or print("torch for Linux comes with gigabytes of CUDA; without a GPU: make TORCH=cpu")'
endif
	$(PIP) -e '.[pipeline,report]'
	touch $@

.venv/installed-dev: .venv/installed
	$(PIP) -e '.[dev]'
	touch $@

repro: .venv/installed
ifdef PROFILE
	@folder=$$(python -m pipeline.workspace profile -- "$$PROFILE") && cd "$$folder" && $(REPRO) && \
	echo "The report: $$folder/data/report/index.html"
else
	@$(REPRO) && echo "The report: $$PWD/data/report/index.html"
	@git diff --quiet -- dvc.lock data/metrics 2>/dev/null || test $$? -ne 1 || \
	echo 'dvc.lock and data/metrics hold the results of this machine now (docs/pipeline.md, "Equal bytes").'
endif

own: .venv/installed
	@folder=$$(python -m pipeline.workspace own $${DATA:+"--data=$$DATA"} $${NAME:+"--name=$$NAME"} \
		$${INCLUDE:+"--include=$$INCLUDE"} $${UP:+"--up=$$UP"}) && cd "$$folder" && $(REPRO) && \
	echo "The report: $$folder/data/report/index.html"

# Snapshots, logs and evaluations stay behind: 3 MB at most.
demo: .venv/installed
	@folder=$$(python -m pipeline.workspace profile demo) && (cd "$$folder" && $(REPRO)) && \
	rm -rf cagesdf/demo/run cagesdf/demo/programs && mkdir -p cagesdf/demo/run cagesdf/demo/programs && \
	cp "$$folder"/data/runs/mixed/cagesdf/*.* cagesdf/demo/run && \
	cp "$$folder"/data/programs/mixed/*.* cagesdf/demo/programs && rm cagesdf/demo/*/log.jsonl

test: .venv/installed-dev
	mkdir -p work
	python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(if $(COVERAGE),--cov --cov-report=term)

check: .venv/installed-dev
	ruff check . && ruff format --check . && mypy
