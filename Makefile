# PhysHDR: `make demo` runs everything once; `make test` proves that it works.
# Both set up what they need first (tools/setup.py) and work again when run twice.

BACKEND := .venvs/backend/bin/python
BLENDER := .venvs/run-blender
PYTHON ?= python3
# A machine with a card may have torch and warp-lang in its own Python, and no .venvs/.
WITH_TORCH := $(if $(wildcard $(BACKEND)),$(BACKEND),$(PYTHON))

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-long fuzz torture benchmark report gpu-check windows-semantics gui-test web-test formats extension dist lock lint clean

help: ## Show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: ## Set up both environments (.venvs/), or say what to install
	@$(PYTHON) tools/setup.py backend blender

demo: setup ## Scene → data → training → relit picture: runs/demo/result.png
	@$(BACKEND) tools/demo.py

test: setup ## Lint, and the tests of both sides of the house, but for what takes long
	@$(PYTHON) tools/run_tests.py

test-long: setup ## What takes long: several trainings, types as on three systems, the installed wheel, short fuzz and torture
	@$(PYTHON) tools/run_tests.py --long

fuzz: setup ## Bad inputs for every reader, for messages and a running server; WITH="--seed 5" and other options
	@$(BACKEND) tests/stress/fuzz.py $(WITH)

torture: setup ## Kills, full disks, two of everything at once, long use (hours); WITH="--only soak" and other options
	@$(BACKEND) tests/stress/torture.py $(WITH)

benchmark: setup ## Speed of the kernels against their alternatives, in one run; WITH="--quick" and other options
	@$(BACKEND) benchmarks/run.py $(WITH)

# What make report runs, each plan in a folder of its own.
PLANS := held_out exp1 published relighting faults length ladder
report: setup ## The comparison, faults, lengths, the paper's steps: lab/tables (days); PLANS=… LPIPS=weights.npz
	@$(BACKEND) lab/tools/benchmark_data.py --plans $(PLANS:%=lab/plans/%.toml)
	@for plan in $(PLANS); do .venvs/backend/bin/physhdr benchmark --plan lab/plans/$$plan.toml --jobs 2 \
		--out runs/report/$$plan --report lab/tables/$$plan.md $(if $(LPIPS),--lpips-weights $(LPIPS)) || exit; done

gpu-check: ## Is what a card computes right, and how fast? Says so and ends where there is no card
	@$(WITH_TORCH) tools/gpu_check.py

# What touches files and takes no training of its own.
ON_WINDOWS := tests/bridge tests/addon/session tests/backend/serve/test_home.py tests/backend/export \
	tests/backend/formats tests/lab/benchmark/test_schedule.py tests/backend/scene/capture \
	tests/backend/runs/test_files.py tests/backend/runs/test_lock.py
windows-semantics: setup ## Tests that touch files, as if Windows kept these; WITH="-k model" and other options
	@$(BACKEND) -m pytest $(ON_WINDOWS) --as-on-windows $(WITH)

gui-test: setup ## The extension in a real Blender window; says so and ends where there can be none
	@$(BACKEND) tools/gui_test.py

web-test: setup ## Web pages in a headless Chromium, against physhdr render; skips, and says why, where there is none
	@$(BACKEND) -m pytest tests/web -rs $(WITH)

formats: setup ## What each format and program makes of the demo's model, into lab/viewers.md; skips what is not there
	@$(BACKEND) lab/tools/formats_table.py $(WITH)

extension: setup ## Validate and build the Blender extension and its repository: dist/physhdr-*.zip, index.json
	@$(BACKEND) tools/build_extension.py

dist: setup ## Build what pip installs: dist/physhdr-*.tar.gz and .whl
	@$(BACKEND) tools/build_dist.py

lock: ## Renew locks/: versions and hashes of what is installed; WITH=--keep adds only what is missing
	@$(PYTHON) tools/lock.py $(WITH)

lint: setup ## ruff and pyright, as on Linux, Windows and macOS; WITH=--whole looks at every file for each
	@$(BACKEND) tools/lint.py $(WITH)

clean: ## Remove what was built (data, runs and environments stay)
	@rm -rf build dist .pytest_cache .ruff_cache
