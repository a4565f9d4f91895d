# Two commands matter: `make demo` and `make test`. Both set everything up by themselves.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
# Tests start many processes: each reads the bytecode that the first one wrote.
unexport PYTHONDONTWRITEBYTECODE

# Linear algebra in one thread, as ocp sets it; benchmarks run their peers in all threads.
check test tests test-cpus test-slow: export OMP_NUM_THREADS ?= 1
check test tests test-cpus test-slow: export OPENBLAS_NUM_THREADS ?= 1

.PHONY: setup demo check test tests test-cpus test-slow test-attack bench bench-solve bench-solvers bench-laws bench-survives bench-mpcc bench-random bench-world bench-found bench-mpc bench-robots arena lint gallery claims docs generated notebooks numbers verdicts refined promises

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	PIP_CONSTRAINT=constraints.txt PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip install --quiet --no-compile --editable ".[dev]"
	touch $(READY)

demo: setup
	$(BIN)/ocp solve push-disc --contact exact --pdf runs/demo.pdf

# What belongs to one file, in seconds: make check FILE=ocp/solve/solve.py
check: setup
	$(BIN)/python -m tests.check $(FILE)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports
	$(BIN)/python -m tests.readability

# Style, types and contracts beside all tests that are not slow or costly (tests/conftest.py).
test: setup
	$(MAKE) --no-print-directory --jobs=2 lint tests

tests: setup
	$(BIN)/pytest -n auto --dist worksteal --ignore tests/attack --ignore tests/benchmarks

# Golden, docs and property tests as on other processors, all that this computer can act;
# CPU="nehalem haswell" some of them. .ci/run acts one a day for all tests.
test-cpus: setup
	$(BIN)/python -m tests.cpus $(CPU)

# All that make test leaves out, and properties on all of their examples, where make test takes 25.
test-slow: setup
	$(BIN)/pytest -m slow -n auto --dist worksteal --ignore tests/property
	EXAMPLES=all $(BIN)/pytest -m "slow or not slow" -n auto --dist worksteal tests/property

# Kills, full disks, flipped bits, crowds, broken files, and nonsense against the whole program, in
# less than twenty minutes; ATTACK_SEED=7 draws others. `make promises` writes the site's table of it.
test-attack: setup
	rm -rf build/attack
	$(BIN)/pytest -m attack -s tests/attack

promises: setup
	$(BIN)/python -m tests.attack.ledger
	$(BIN)/python -m docs.generator

bench: setup
	$(BIN)/pytest -m bench -s tests/benchmarks tests/unit/benchmarks

# Solves every named problem from 21 guesses and rewrites the table of the site;
# PROBLEMS="hopper push-1d" does some of them.
bench-solve: setup
	$(BIN)/python -m tests.benchmarks.ocp.dependability $(PROBLEMS)

# Solves every named problem by every solver that ocp list names, each for a limited time, and
# rewrites the table of the site; PROBLEMS="hopper push-1d" does some of them.
bench-solvers: setup
	$(BIN)/python -m tests.benchmarks.ocp.solvers $(PROBLEMS)

# Solves every named problem under the exact law and the barrier from ten perturbed guesses, compares
# what the referee makes of the plans, and rewrites the table of the site.
bench-laws: setup
	$(BIN)/python -m tests.benchmarks.ocp.default_law $(PROBLEMS)

# Solves every named problem until it survives the referee, each command within LIMIT seconds of
# processor time, and rewrites the table of the site; PROBLEMS="hopper push-1d" does some of them.
LIMIT ?= 900
bench-survives: setup
	$(BIN)/python -m tests.benchmarks.ocp.survives --limit $(LIMIT) $(PROBLEMS)

# Solves the AMPL .nl files of complementarity problems under DIR, with reference.csv beside them,
# against a plain Scholtes loop, in processor time, and rewrites the table of the site; stopped, it
# goes on where it was. CHECK=--cross-check tries to disprove the certificates.
bench-mpcc: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.benchmarks.mpcc.bench $(DIR) $(CHECK)

# Solves instances of ten problems with drawn parameters by the default route and by all our other
# ways, which it compares; COUNT=5 draws five a problem, PROBLEMS="push-1d" of some of them,
# and SEED=7 other instances. Answers of the other ways are kept in runs/bench-random.json and read
# again.
COUNT ?= 30
SEED ?= 0
bench-random: setup
	$(BIN)/python -m tests.benchmarks.ocp.random_instances --count $(COUNT) --seed $(SEED) $(PROBLEMS)

# Ten scenes of the plane by the default command, and push-box and push-t from many starts
# (SCENES="box tee" those with such words); then a box pushed round an obstacle, N = 100, fifty
# times, and problems that switch and jump, against a plain Scholtes loop.
bench-world: setup
	$(BIN)/python -m tests.benchmarks.ocp.world $(SCENES)
	$(BIN)/python -m tests.benchmarks.ocp.pushing
	$(BIN)/python -m tests.benchmarks.mpcc.switching

# What the default command finds on thirty problems of strangers and two named ones, against the best
# known plans, and rewrites the table of the site; PROBLEMS="hammer pivot_box" some of them, SEEDS=20
# with as many seeds, EFFORT=quick with that effort. The best known plans come from
# `python -m tests.benchmarks.found --reference NAME`.
SEEDS ?= 1
bench-found: setup
	$(BIN)/python -m tests.benchmarks.found $(PROBLEMS) --seeds $(SEEDS) $(if $(EFFORT),--effort $(EFFORT))

# Reference tasks in closed loop, each beside a plain Opti loop, and the quadratic programs of a
# sample by other solvers, and rewrites the tables of the site; TASKS=soft-walls,spinner some of them.
bench-mpc: setup
	$(BIN)/python -m tests.benchmarks.mpc.bench $(TASKS)

# Equations of published robots against MuJoCo, the quadruped's stage and iteration, rollouts of the
# ant; EXTRA_ROBOTS=DIR:DIR has robots of packages that are not installed, PEERS=PYTHON is one with
# pin and adam-robotics; PARTS="stage rollouts" some of it.
bench-robots: setup
	PEERS="$(PEERS)" EXTRA_ROBOTS="$(EXTRA_ROBOTS)" $(BIN)/python -m tests.benchmarks.robots.bench $(PARTS)
	EXTRA_ROBOTS="$(EXTRA_ROBOTS)" $(BIN)/python -m tests.benchmarks.robots.plans

# Public tasks by the default command, by quick effort and by their published formulations, one judge for
# all; writes the site's table and figure, and what `ocp arena compare` knows of ocp solve. JOBS=16 answers
# at a time; stopped, it goes on where it was. ARENA="waiter --out build/waiter.json" has some tasks alone.
JOBS ?= 1
arena: setup
	$(BIN)/python -m tests.benchmarks.arena --jobs $(JOBS) $(ARENA)

# The site, from docs/ and docstrings into build/site; warnings are errors, and nothing is fetched.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo build/site/index.html

# Pages of docs/generated, from specs, help texts and the JSON in docs/generated/data.
generated: setup
	$(BIN)/python -m docs.generator

# Executes the notebooks of examples/ and stores what their cells give, for the site and for readers.
notebooks: setup
	$(BIN)/python -m tests.notebooks

# Measures a random 20 of the site's numbers again, SEED=7 others, COUNT=5 fewer; it fails where one
# differs. Seconds are exempt, and what `console` blocks print is compared by make test.
NUMBERS := $(if $(SEED),--seed $(SEED)) $(if $(filter command line,$(origin COUNT)),--count $(COUNT))
numbers: setup
	$(BIN)/python -m tests.benchmarks.numbers $(NUMBERS)

# Solves every named problem under every law and by every method for the site;
# PROBLEMS="hopper push-1d" some of them.
verdicts: setup
	$(BIN)/python -m docs.generator.verdicts $(PROBLEMS)
	$(BIN)/python -m docs.generator

# Refines the step of every named problem; PROBLEMS="hopper" some of them.
refined: setup
	$(BIN)/python -m docs.generator.verdicts --refine $(PROBLEMS)
	$(BIN)/python -m docs.generator

# Makes every figure of the papers and stores their claims and pictures for the site.
claims: setup
	mkdir -p runs/claims
	$(BIN)/ocp figure --all --json --quiet --out runs/claims > runs/claims/figures.json
	$(BIN)/python -m docs.generator.figures runs/claims/figures.json
	$(BIN)/python -m docs.generator

# Pictures of the README: these problems in this order, solved under the exact law, or as
# SOLVE_<problem> says, and as animations.
GALLERY := wall-1d push-1d box-slide ball-bounce ball-throw cart-transport \
	push-disc planar-push planar-hand cart-walls hopper-1d hopper half-cheetah push-box push-t \
	soft-walls spinner finger-disc idto-hopper quadruped ant push-cube reorient
SOLVE_cart-walls := --contact barrier -c mu=1e-3
SOLVE_push-box := --contact exact -s strategy=scholtes-exact
SOLVE_push-t := --contact exact -s strategy=l1

gallery: setup
	$(foreach name,$(GALLERY),$(BIN)/ocp solve $(name) $(or $(SOLVE_$(name)),--contact exact) \
		--out runs/gallery --quiet &&) true
	$(BIN)/python -m docs.generator.readme_pictures runs/gallery docs/pictures --still $(GALLERY) \
		--moving $(GALLERY)
	$(BIN)/python -m docs.generator.guess_picture
