# `make help` lists the targets. Everything is installed into .venv.
CONFIG ?= config/demo$(if $(CHIP),-chip).yaml
RIG := .venv/bin/rig
# where it is set, each of the thousand processes that the tests start compiles all its packages anew
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup compiled bam evidence whole stalls free-running compare pages dist docs stopping campaign-real design emps real-records tracking tune wheel help demo test search check lint types analysis format bench figures paper safety soak faults mutants fuzz firmware golden lock clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' Makefile

demo: .venv/.running  ## the whole experiment on the emulated serial device, in virtual time; REALTIME=1: in real time; CHIP=1: on the Uno's emulated chip
ifdef REALTIME
	@mkdir -p build
	sed 's/port: emulated  /port: emulated-realtime  /' $(CONFIG) > build/realtime.yaml
	$(RIG) run build/realtime.yaml
else
	$(RIG) run $(CONFIG)
endif
	@echo 'to type rig as it stands here: . .venv/bin/activate'

setup: .venv/.ready  ## all that tests, checks, documents and panel need, Debian packages included, by sudo; make test does it

PYTEST := OPENBLAS_NUM_THREADS=1 .venv/bin/pytest
SHARED := --maxprocesses 8 --dist loadfile --no-loadscope-reorder
# to collect the others would take longer than many of these tests
MARKED = $$(grep -lrE 'mark\.($(1))' tests --include='test_*.py')

# some wait for processes of theirs, and what runs in real time waits more than it computes: so there are more workers than cores; what measures how late something is runs alone, after the rest
# mypy has one core for longer than all other checks have the other one: it runs beside the tests, and what it says comes after them
test: .venv/.ready  ## check, and every test but the long evidence, the firmware's own included
	@$(MAKE) --no-print-directory -j$$(nproc) -O $(CHECKS) firmware compiled
	@mkdir -p build; .venv/bin/mypy >build/types.txt 2>&1 & types=$$!; \
	    $(PYTEST) -m "not (alone or evidence)" -n $$((2 * $$(nproc))) $(SHARED); tests=$$?; \
	    wait $$types || tests=1; cat build/types.txt; exit $$tests
	$(PYTEST) -m "alone and not evidence" $(call MARKED,alone)

# once in a clone, and not in each worker: what the tests load; a test that does not load shows after it
compiled: build/.compiled
build/.compiled: .venv/.ready | firmware
	@mkdir -p build; $(PYTEST) --collect-only -qq -p no:unraisableexception >/dev/null || true; touch $@

evidence: .venv/.ready firmware  ## the tests that compute long: full ranges of parameters, matrices, campaigns
	$(PYTEST) -m "evidence and not (realtime or alone)" -n $$(nproc) $(SHARED)
	$(PYTEST) -m "evidence and (realtime or alone)" $(call MARKED,realtime|alone)

search: .venv/.ready firmware  ## the properties among the tests, with other random examples each time: TIMES=10 over
	@for round in $$(seq $(or $(TIMES),10)); do echo "round $$round"; $(PYTEST) \
	    -m hypothesis --hypothesis-profile=search || exit 1; done

CHECKS := lint pages analysis
check: types $(CHECKS)  ## format, lint, types, import contract, docs, signatures, docstrings; the firmware's C by cppcheck and MISRA

lint: .venv/.ready
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	.venv/bin/lint-imports
	.venv/bin/python tools/check_docs.py
	.venv/bin/python tools/check_signatures.py
	.venv/bin/python tools/check_docstrings.py

types: .venv/.ready
	.venv/bin/mypy

# read and resolved, as `make docs` does; what that writes then, nobody reads here, nor its curly quotes
pages: .venv/.ready
	.venv/bin/sphinx-build -q -W --keep-going -b dummy -D smartquotes=0 docs build/pages

analysis: .venv/.ready
	@$(MAKE) --no-print-directory -s -C firmware cppcheck

docs: .venv/.ready  ## the documentation as a site, the tutorial run and a gallery of reports, in build/site
	.venv/bin/python tools/gallery.py docs/gallery
	RIG_TUTORIAL=force .venv/bin/sphinx-build -q -W --keep-going docs build/site
	@echo "open build/site/index.html"

format: .venv/.ready  ## format the Python code
	.venv/bin/ruff check --fix --quiet . || true
	.venv/bin/ruff format .

bench: .venv/.ready firmware  ## timing ratios, written to bench.json
	PYTHONPATH=tools .venv/bin/python -m bench

campaign-real: .venv/.ready  ## thousands of motors that are not what the plain model says: docs/evidence/real-motors-table.md; it resumes; OUTSIDE=100: motors with laws that rig has not: outside.md
ifdef OUTSIDE
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m campaign_real.outside --page --motors $(OUTSIDE) \
	    $(if $(SEED),--seed $(SEED)) $(if $(JOBS),--jobs $(JOBS))
else
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m campaign_real config/campaign-real.yaml \
	    $(if $(MOTORS),--motors $(MOTORS)) $(if $(PAIRS),--pairs $(PAIRS)) $(if $(SEED),--seed $(SEED)) $(if $(KEEP),--keep) \
	    $(if $(RUNS),--runs) $(if $(KIND),--kind "$(KIND)") $(if $(RECHECK),--recheck $(RECHECK)) $(if $(PAGE),--page $(PAGE))
endif

stopping: .venv/.ready  ## how soon an experiment knows its motor, on hundreds of motors: docs/evidence/stopping-table.md; it resumes
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m stopping \
	    $(if $(MOTORS),--motors $(MOTORS)) $(if $(KNOWN),--known $(KNOWN)) $(if $(AFTERWARDS),--afterwards $(AFTERWARDS)) $(if $(DEPARTING),--departing $(DEPARTING)) $(if $(SEED),--seed $(SEED)) $(if $(KEEP),--keep) \
	    $(if $(PERCENT),--percent $(PERCENT)) $(if $(PAGE),--page $(PAGE))

free-running: .venv/.ready  ## how often the breakaway check names a bridge that runs free, and falsely one that brakes
	OPENBLAS_NUM_THREADS=1 .venv/bin/python tools/free_running_rates.py $(if $(MOTORS),--motors $(MOTORS)) $(if $(SEED),--seed $(SEED))

compare: .venv/.ready  ## how often rig compare is wrong of simulated runs, and what it finds: docs/evidence/compare-table.md; it resumes
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m comparing \
	    $(if $(SAME),--same $(SAME)) $(if $(DRIFTED),--drifted $(DRIFTED)) $(if $(LAWS),--laws $(LAWS)) $(if $(SEED),--seed $(SEED))

emps: .venv/.ready  ## a real drive, the benchmark EMPS, beside its published numbers; RIG_EMPS names DATA_EMPS.mat
	PYTHONPATH=tools .venv/bin/python -m emps

bam: .venv/.ready  ## what rig identify says of servos with the friction that Rhoban/bam publishes; RIG_SHARED_DATA names the folder with bam
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m bam $(if $(SEED),--seed $(SEED))

real-records: .venv/.ready  ## what rig identify says of records of real motors; RIG_SHARED_DATA names the folder with real, emps and cases
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m real_records real emps --page

tune: .venv/.ready  ## loops tuned on identified motors, tried on the true ones: docs/evidence/tune-table.md; it resumes
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m tune \
	    $(if $(MOTORS),--motors $(MOTORS)) $(if $(DEPARTING),--departing $(DEPARTING)) $(if $(SEED),--seed $(SEED))

tracking: .venv/.ready  ## tracking with and without the laws of the motor: docs/evidence/tracking-table.md
	PYTHONPATH=tools .venv/bin/python tools/tracking_table.py

design: .venv/.ready  ## how soon designed tests tell enough, beside a free optimum: docs/evidence/design-table.md
	PYTHONPATH=tools .venv/bin/python tools/design_table.py

stalls: .venv/.ready firmware  ## random motors, driven by a host that stands still at random: docs/evidence/stalls-table.md; it resumes
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m stalls \
	    $(if $(MOTORS),--motors $(MOTORS)) $(if $(CHIPS),--chips $(CHIPS)) $(if $(SEED),--seed $(SEED)) $(if $(JOBS),--jobs $(JOBS)) \
	    $(if $(PAGE),--page $(PAGE))

paper: .venv/.ready  ## the paper's examples redone: one report, build/paper/report.html
	PYTHONPATH=tools .venv/bin/python -m paper

figures: .venv/.ready  ## the figures of README and docs/theory.md: docs/figures
	PYTHONPATH=tools .venv/bin/python tools/figures.py

safety: .venv/.ready firmware  ## what stops the drive, and how soon, on the Uno's emulated chip; BOARD=pico: on the Pico's: docs/evidence/safety-table.md
	PYTHONPATH=tools .venv/bin/python -m safety $(if $(BOARD),--board $(BOARD))

soak: .venv/.ready firmware  ## HOURS=8 of the devices' time, run after run, with faults at random; half an hour or so
	PYTHONPATH=tools .venv/bin/python -m faults.soak --hours $(or $(HOURS),8)

whole: .venv/.ready firmware  ## whether TIMES=20 runs of the demo end whole: beside busy loops, stopped now and then, in real time
	PYTHONPATH=tools .venv/bin/python tools/whole.py --times $(or $(TIMES),20) $(if $(ASK),--ask $(ASK))

fuzz: .venv/.ready  ## what the host reads, fuzzed; SECONDS_EACH=60 for each target; counts are printed
	PYTHONPATH=tools .venv/bin/python -m fuzz --seconds $(or $(SECONDS_EACH),60)

faults: .venv/.ready firmware  ## what goes wrong, on every emulated device, and what the bench does: docs/evidence/fault-table.md, docs/evidence/fault-rows.md
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tools .venv/bin/python -m faults

mutants: .venv/.ready firmware  ## defects put in on purpose, one at a time: each must fail a test: docs/evidence/mutant-table.md
	PYTHONPATH=tools .venv/bin/python -m mutants

firmware: .venv/.ready  ## the firmware (build/firmware/uno/rig_uno.hex, pico/rig_pico.uf2), and the emulated board and chips
	@$(MAKE) --no-print-directory -C firmware host uno chip pico pico-chip

wheel: .venv/.ready  ## a wheel with the Uno's firmware of every variant: dist
	RIG_FIRMWARE=required .venv/bin/uv build --quiet --wheel -o dist

WHEELS := manylinux_2_17_x86_64 manylinux_2_17_aarch64 win_amd64 macosx_11_0_arm64 macosx_11_0_x86_64

dist: .venv/.ready  ## source, and a wheel of each platform, as they would be published, checked: dist
	rm -rf dist build/dist
	.venv/bin/uv build --quiet --sdist -o dist
	for platform in $(WHEELS); do RIG_WHEEL=$$platform RIG_FIRMWARE=required RIG_FIRMWARE_BUILD="$(CURDIR)/build/dist" \
	    .venv/bin/uv build --quiet --wheel -o dist || exit 1; done
	.venv/bin/twine check --strict dist/*
	.venv/bin/python tools/try_wheels.py dist

golden: .venv/.ready firmware  ## the golden recordings that live in virtual time, anew: docs/replay.md
	.venv/bin/python tools/golden.py

lock: .venv/.ready  ## lock the packages anew
	.venv/bin/uv pip compile --quiet pyproject.toml --group dev --generate-hashes --universal \
	    --python-version 3.11 --no-header --upgrade -o requirements.lock

clean:  ## remove what was built; run folders stay
	$(MAKE) --no-print-directory -C firmware clean
	rm -rf build dist .venv .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	rm -rf tests/hil/avr8js/node_modules firmware/emulator/pico/node_modules tools/uplot/node_modules rig/panel/static/vendor
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# what rig runs on, no more
.venv/.running: pyproject.toml requirements.lock tools/setup.sh
	@./tools/setup.sh running

.venv/.ready: pyproject.toml requirements.lock tests/hil/avr8js/package-lock.json firmware/emulator/pico/package-lock.json tools/uplot/package-lock.json tools/setup.sh tools/uplot.sh
	@./tools/setup.sh
