# Everything a fresh machine needs: `make demo` and `make test` set up what is missing first.
PYTHON ?= python3
BIN := .venv/bin
# Processes that share the tests; each starts ngspice in a process of its own.
WORKERS ?= auto
OUT ?= out/demo

.PHONY: demo test slow fuzz bench docs dist paper gallery lint setup clean

demo: setup
	$(BIN)/cosim run scenes/slope.toml --out $(OUT)
	$(BIN)/cosim report $(OUT)
	@echo "Open $(OUT)/report/report.html in a browser."

test: setup
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal

slow: setup
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal -m slow

# Half an hour and more: 20,000 inputs, 500 commands, 50 kills, and the netlist loader by coverage where atheris is.
SEED ?= 1
fuzz: setup
	$(BIN)/python -m tests.fuzz --seed $(SEED)
	! $(BIN)/python -c "import atheris" 2>/dev/null || $(BIN)/python -m tests.fuzz.coverage -runs=5000 -seed=$(SEED)

# Against peers, and against the committed figures; `python -m benchmarks --commit` renews these.
bench: setup .venv/bench
	$(BIN)/python -m benchmarks

.venv/bench: .venv/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint requirements.lock --editable '.[bench]'
	@touch $@

# The site, into site/: warnings, links to nowhere among them, are errors. `cosim docs` serves it.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

# What is released: wheel and sdist with the site inside, into dist/.
dist: docs
	$(BIN)/python -m build --outdir dist

# The paper, figure by figure and claim by claim, and the published pictures of it.
paper: setup
	$(BIN)/cosim report scenes/paper/ -o out/paper
	mkdir -p reports/gallery
	cp out/paper/figures/0_1_acceptance_gains.png reports/gallery/paper_gains.png
	cp out/paper/figures/1_fig13_limits.png reports/gallery/paper_fig13.png
	cp out/paper/figures/3_fig16_18_runs.png reports/gallery/paper_fig16_18.png
	cp out/paper/figures/4_fig18_poses_drag.png reports/gallery/paper_poses.png
	cp out/paper/figures/5_1_eta_eta.png reports/gallery/paper_footnote1.png
	cp out/paper/figures/7_footnote2_congruence.png reports/gallery/paper_footnote2.png
	cp out/paper/figures/7_footnote2_preloads.png reports/gallery/paper_preloads.png

# The published pictures: those of the paper, its three methods on the slope, and the effects ledger.
gallery: paper
	for method in discrete combined joint_pd; do \
	  $(BIN)/cosim run scenes/slope_$$method.toml --out out/gallery/$$method || exit 1; done
	$(BIN)/cosim report out/gallery/discrete out/gallery/combined out/gallery/joint_pd --out out/gallery/report
	$(BIN)/cosim effects scenes/slope.toml --out out/gallery/effects
	$(BIN)/cosim accuracy scenes/press.toml --out out/gallery/accuracy
	mkdir -p reports/gallery
	cp out/gallery/report/figures/compare.png reports/gallery/methods.png
	cp out/gallery/report/figures/zoom.png reports/gallery/between_samples.png
	cp out/gallery/report/figures/path.png reports/gallery/path.png
	cp out/gallery/effects/effects.png reports/gallery/effects.png
	cp out/gallery/accuracy/figures/accuracy.png reports/gallery/work_precision.png

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

setup: .venv/ready
	@sh setup/ngspice.sh
	@$(BIN)/cosim warm >/dev/null

# The lock pins every package; it is written by `uv pip compile pyproject.toml --extra test --extra docs --universal`.
.venv/ready: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "Python 3.11 or newer is needed; found `$(PYTHON) --version`. Try: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -m venv .venv \
	  || { rm -rf .venv; echo "Python's venv is missing. On Debian or Ubuntu: sudo apt-get install make python3-venv ngspice libngspice0" >&2; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

clean:
	rm -rf .venv out site dist
