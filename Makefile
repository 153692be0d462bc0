# piegraph: `make demo` and `make test` set up .venv and need nothing else; see README.md.
PYTHON ?= python3
JOBS ?= 2
# the address of PyTorch's CPU index (PyTorch's install page has it): torch without CUDA; docs/install.md
TORCH_INDEX ?=
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
LIBRARIES := libgl1 libegl1 libgles2 libx11-6 libudev1 libusb-1.0-0
IMPORTS := import importlib.util, cv2, mediapipe, open3d; importlib.util.find_spec('pyrealsense2') and __import__('pyrealsense2')
export PYTHONUNBUFFERED := 1

EXPERIMENTS := table1 dynamics planning ablations data-fidelity few-strokes recordings robot noise guidance search pushes

SAMPLE ?= 150

SECONDS ?= 600

.PHONY: setup demo test smoke lint tables mutants attack kills full-disk libraries browser clean reproduce troubles $(EXPERIMENTS)

setup: .venv/.ready

.venv/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 10) <= v < (3, 13) else f"piegraph needs Python 3.10 to 3.12, this is {v[0]}.{v[1]}: make PYTHON=python3.12 ...")'
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv || { $(PYTHON) -m pip install --user virtualenv && $(PYTHON) -m virtualenv .venv; }
	@if [ -n "$(TORCH_INDEX)" ]; then \
		$(PIP) install --quiet -c constraints.txt --no-deps --index-url "$(TORCH_INDEX)" torch; \
	elif [ "$$(uname -sm)" = "Linux x86_64" ] && [ ! -e /proc/driver/nvidia/version ] \
		&& ! $(PIP) install --dry-run -c constraints.txt --no-deps torch 2>/dev/null | grep -qE '\+cpu|already satisfied'; then \
		echo "There is no NVIDIA GPU here, and torch brings CUDA along, 4 GB; make TORCH_INDEX=... does without: docs/install.md"; \
	fi
	$(PIP) install --quiet -c constraints.txt -e '.[sim,dev]'
	@$(BIN)/python -c "$(IMPORTS)" 2>/dev/null || $(MAKE) --no-print-directory libraries
	$(BIN)/piegraph doctor --fetch hand-landmarker
	@touch $@

# the system libraries that open3d and pyrealsense2 link; only where importing them fails
libraries:
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		apt-get update -qq && apt-get install -y -qq --no-install-recommends $(LIBRARIES); \
	else \
		echo "open3d and pyrealsense2 need system libraries: sudo apt-get install $(LIBRARIES)"; \
	fi
	@$(BIN)/python -c 'import cv2, mediapipe, open3d'  # pyrealsense2 is for some tests alone

# Chromium, in which tests open the viewer and the report; without one they are skipped
browser: setup
	@if command -v chromium >/dev/null || command -v google-chrome >/dev/null || ls $$HOME/.cache/ms-playwright/chromium-* >/dev/null 2>&1; then \
		echo "a browser is there"; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium; \
	else \
		echo "tests in a browser need Chromium: sudo apt-get install chromium, or $(BIN)/playwright install --with-deps chromium"; \
	fi

# the whole pipeline on sample_data/, then its pictures
demo: setup
	$(BIN)/piegraph run pipelines/demo.toml --run runs/demo --jobs $(JOBS)
	$(BIN)/piegraph evaluate --run runs/demo
	$(BIN)/piegraph report --run runs/demo

# a file's tests stay in one process; runs that several files read are made once for all
test: setup
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile

# a few minutes: every stage on the sample with a short training, into a folder of its own
smoke: setup
	$(BIN)/piegraph run pipelines/demo.toml --run runs/smoke --jobs $(JOBS) --set train.piegraph.steps=100 --set plan.strokes=2
	$(BIN)/piegraph status --run runs/smoke

# do the tests notice mistakes? SAMPLE small changes to the code, one at a time; see docs/testing.md
mutants: setup
	$(BIN)/python -m tests.mutation.run --sample $(SAMPLE) --jobs $(JOBS)

# damaged and hostile files of every kind for so many seconds, what became of each, and the seeds that repeat a fault
attack: setup
	$(BIN)/python -m tests.attack --seconds $(SECONDS)

# commands that are killed, ended and interrupted at random moments of all stages, for so many seconds
kills: setup
	$(BIN)/python -m tests.attack.kills $(SECONDS)

# every command that writes, on a disk that is full at one of its writes after the other; MOST=5 of each command
full-disk: setup
	$(BIN)/python -m tests.attack.full_disk $(if $(MOST),--most $(MOST))

# the paper's experiments, each with its table and pictures in runs/paper/report: hours; `make table1 QUICK=1`: minutes,
# into runs/quick. Interrupt and repeat at will: what is done is kept. HOURS=2 begins nothing after two hours;
# KEEP=results/pieces keeps the pieces that the tables of docs/ are made from
$(EXPERIMENTS): setup
	$(BIN)/piegraph reproduce $@ --jobs $(JOBS) $(if $(QUICK),--quick) $(if $(DATA),--data "$(DATA)") $(if $(HOURS),--hours $(HOURS)) $(if $(KEEP),--keep "$(KEEP)")

# recordings that are wrong on purpose, and what ingest says of them: the table of docs/checks.md
troubles: setup
	$(BIN)/piegraph reproduce troubles --jobs $(JOBS) $(if $(QUICK),--quick)

reproduce: setup
	$(BIN)/piegraph reproduce all --jobs $(JOBS) $(if $(QUICK),--quick) $(if $(HOURS),--hours $(HOURS)) $(if $(KEEP),--keep "$(KEEP)")

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# the tables of README.md and docs/ from results/ and its pieces, docs/settings.md from the settings, docs/json.md from what commands tell
tables: setup
	$(BIN)/python -m tools.tables
	$(BIN)/python -m tools.settings
	$(BIN)/python -m tools.json_page

clean:
	rm -rf .venv runs build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
