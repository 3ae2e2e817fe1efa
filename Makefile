# Python 3.11 or newer and make are enough: each target sets up what it needs in .venv first.

PYTHON ?=
export PYTHON
# `all` executes the long tests, too.
TESTS ?=
export TESTS

# A sourced ROS puts its own packages and pytest plugins before ours; here everything comes from .venv.
unexport PYTHONPATH
unexport PYTHONHOME
# The tests start Python some thousand times; without kept bytecode each would compile everything anew.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
CODE := src tests benchmarks scripts examples robot

.DEFAULT_GOAL := help
.PHONY: help demo test check bench soak docs cli-page format picture gallery lock lower-bounds dist system-packages environment ready clean

help: ## Show this list.
	@echo "Robot Runner. Python 3.11 or newer and make are enough; every target does its own set-up."
	@echo
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1|\2/p' Makefile | awk -F '|' '{ printf "%-22s %s\n", $$1, $$2 }'
	@echo
	@echo "  PYTHON=python3.13 make test   chooses the Python."
	@echo "  TESTS=all make test   executes the long tests, too, as CI does (half an hour)."
	@echo "  ROBOT_RUNNER_SYSTEM_PACKAGES=no make test   installs no Debian packages; tests that need a missing one are skipped."

demo: ## Execute the paper's experiment on the embedded robot: 15 runs, in under a minute.
	@sh scripts/set_up.sh demo
	@$(BIN)/robot-runner demo

test: ready ## Make every check and execute the tests, but for the long ones (minutes).
	@sh scripts/checks.sh all

check: ## Make the quick checks only: format, lint, types, import contracts.
	@sh scripts/set_up.sh test
	@sh scripts/checks.sh quick

bench: ready ## Measure the promised figures, each beside its floor (minutes; a quiet machine is best).
	@$(BIN)/python -m benchmarks

soak: ready ## Execute the long-running tests, and search all properties at random (hours).
	@$(BIN)/python scripts/execute_tests.py -m "soak or hypothesis" --hypothesis-profile soak --timeout 3600

docs: ## Build the documentation into site/.
	@sh scripts/set_up.sh test
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "Open site/index.html: links, search and colours work without a server and without a network."

cli-page: ## Write docs/cli.md anew from the program.
	@sh scripts/set_up.sh test
	@$(BIN)/python scripts/generate_cli_page.py

format: ## Format the code, and mend what the linter can mend by itself.
	@sh scripts/set_up.sh test
	@$(BIN)/ruff check --fix --quiet $(CODE) || true
	@$(BIN)/ruff format $(CODE)

picture: ## Record the demo into docs/images/demo.svg.
	@sh scripts/set_up.sh test
	@$(BIN)/python scripts/record_demo.py docs/images/demo.svg -- $(BIN)/robot-runner demo

gallery: ## Picture the reports of the gallery's studies, and record the live page, into docs/images (minutes).
	@sh scripts/set_up.sh test
	@$(BIN)/python scripts/make_gallery.py .make/gallery --pictures docs/images/gallery
	@$(BIN)/python scripts/record_page.py docs/images/live-page.webp

lock: ## Bring the locked versions in requirements/ up to date.
	@sh scripts/set_up.sh test
	@sh scripts/lock.sh

lower-bounds: ## Execute the tests with the oldest dependencies that pyproject.toml allows.
	@sh scripts/set_up.sh test
	@sh scripts/lower_bounds.sh

dist: ## Build what is published into dist/; refuses a tag that is not the version.
	@sh scripts/set_up.sh test
	@sh scripts/dist.sh

system-packages: ## Install the Debian packages that the tests need (as root).
	@sh scripts/system_packages.sh

environment: ## Make .venv with what the tests need.
	@sh scripts/set_up.sh test

# Debian's packages are unpacked while pip is busy; Debian's ROS 1 joins an environment that is there. Only the first of
# two jobs may be asked by the terminal.
ready: ## Install all that the tests need: both of these, at once.
	@$(MAKE) --no-print-directory --jobs=2 system-packages environment
	@sh scripts/debian_ros.sh

clean: ## Remove .venv and everything else that was generated.
	@rm -rf .venv .make build dist site .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .coverage
	@find src tests benchmarks scripts examples -name __pycache__ -type d -prune -exec rm -rf {} +
