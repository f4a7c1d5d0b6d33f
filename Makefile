# Two commands do all the set-up: `make demo` and `make test`. Everything is installed into .venv, nothing outside.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# on two cores: two have an arm in real time, the others compute, or wait for a client or a browser
WORKERS ?= 4
# more threads of linear algebra would only fight over the cores
export OMP_NUM_THREADS ?= 1
# the suite starts hundreds of commands: each would compile the program anew
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo user deb wheel release system-python quick test docs texts pictures card lint bench soak excitations install uninstall clean

help: ## what can be made
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/'

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "joint-monitor needs Python 3.11 or newer; say which: make PYTHON=python3.11 ..." >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { echo "python3 -m venv failed: on Debian and Ubuntu, apt-get install python3-venv" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: $(STAMP) ## the main job: a simulated UR5 whose joint wears, watched for weeks in about two minutes
	$(BIN)/joint-monitor demo

quick: $(STAMP) ## what needs no process and no socket, in a minute
	$(BIN)/python -m pytest -n 2 --dist loadgroup -m "not soak and not slow" $(addprefix tests/,model identify judge design store config test_reason.py)

test: $(STAMP) ## the whole ordinary suite
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "not soak"

soak: $(STAMP) ## the longer evidence: kills, faults, fuzz, fleets; bounded and seeded
	$(BIN)/python -m pytest -n 2 --dist loadgroup -m soak

card: $(STAMP) ## what the verdicts are worth: docs/figures.md from a seeded fleet of 480 arms and 57 worlds, about 50 minutes
	$(BIN)/python -m tests.evidence.card

docs: $(STAMP) ## the pages that are generated, and the site of all pages in build/site
	$(BIN)/python docs/site/reference.py
	$(BIN)/python docs/site/program_tree.py
	$(BIN)/mkdocs build --strict --quiet --config-file docs/site/mkdocs.yml
	@echo "build/site/index.html"

texts: $(STAMP) ## gather the texts of page and report into their catalogues, and compile these
	$(BIN)/python docs/site/texts.py

pictures: $(STAMP) ## the pictures of the pages in docs, taken in a real Chromium
	JOINT_MONITOR_PICTURES=1 $(BIN)/python -m pytest -q tests/views/test_pictures.py

lint: $(STAMP) ## style, types, and who may import whom
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP) ## how fast, side by side in one run
	$(BIN)/python -m tests.bench
	$(BIN)/python -m tests.bench.idle

MODELS ?= ur3 ur5 ur10 ur3e ur5e ur10e ur16e ur20 ur30
excitations: $(STAMP) ## design config/excitation anew, each with its proof: the same files again, about eight minutes
	for robot in $(MODELS); do for mounting in ground ceiling wall; do \
		$(BIN)/joint-monitor design --robot $$robot --mounting $$mounting --seed 1 --evaluations 3000 --speed-limit 2.2 --flange-speed-limit 1.5 \
			--force -o config/excitation/$$robot-$$mounting.json || exit; done; done

# A service for this machine. Again is an upgrade: history and configuration stay where they are, and the history is migrated by the next start.
PREFIX ?= /opt/joint-monitor
SYSTEM ?= /usr/local/lib
COMMAND ?= /usr/local/bin
INTO := $(DESTDIR)$(PREFIX)
install: ## as a service: a virtual environment below PREFIX (/opt/joint-monitor), unit and user in place; as root
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "joint-monitor needs Python 3.11 or newer; say which: make PYTHON=python3.11 ..." >&2; exit 2; }
	@# the service runs as a user of its own, with ProtectHome
	@$(PYTHON) -c 'import sys; sys.exit(sys.base_prefix.startswith(("/root/", "/home/")))' || { echo "the service cannot reach a Python below /root or /home; say another: make $(MAKECMDGOALS) PYTHON=/usr/bin/python3" >&2; exit 2; }
	@# the service's user reads what root installs, whatever root's umask is
	umask 022; $(PYTHON) -m venv $(INTO)
	umask 022; $(INTO)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --upgrade '.[archive,gateway]'
	@# a package is built elsewhere than it will lie
	test -z "$(DESTDIR)" || grep -lI "$(INTO)" $(INTO)/bin/* $(INTO)/pyvenv.cfg | xargs sed -i 's#$(INTO)#$(PREFIX)#g'
	install -d $(DESTDIR)$(SYSTEM)/systemd/system $(DESTDIR)$(SYSTEM)/sysusers.d $(DESTDIR)$(SYSTEM)/tmpfiles.d $(DESTDIR)/etc/joint-monitor $(DESTDIR)$(COMMAND)
	umask 022; sed 's#/opt/joint-monitor/#$(PREFIX)/#g' deploy/joint-monitor@.service > $(DESTDIR)$(SYSTEM)/systemd/system/joint-monitor@.service
	umask 022; sed 's#/opt/joint-monitor/#$(PREFIX)/#g' deploy/joint-monitor-plant.service > $(DESTDIR)$(SYSTEM)/systemd/system/joint-monitor-plant.service
	umask 022; sed 's#/opt/joint-monitor/#$(PREFIX)/#g' deploy/joint-monitor-gateway.service > $(DESTDIR)$(SYSTEM)/systemd/system/joint-monitor-gateway.service
	ln -sfn $(PREFIX)/bin/joint-monitor $(DESTDIR)$(COMMAND)/joint-monitor
	install -m 644 deploy/joint-monitor.sysusers $(DESTDIR)$(SYSTEM)/sysusers.d/joint-monitor.conf
	install -m 644 deploy/joint-monitor.tmpfiles $(DESTDIR)$(SYSTEM)/tmpfiles.d/joint-monitor.conf
	@# ours alone, not whatever else this machine has lying there
	test -n "$(DESTDIR)" || { systemd-sysusers $(SYSTEM)/sysusers.d/joint-monitor.conf && systemd-tmpfiles --create $(SYSTEM)/tmpfiles.d/joint-monitor.conf; }
	test -n "$(DESTDIR)" -o ! -d /run/systemd/system || systemctl daemon-reload
	@# a package says so where it is installed
	@test -n "$(DESTDIR)" || echo "installed; now: joint-monitor init /etc/joint-monitor/NAME.toml, then: systemctl enable --now joint-monitor@NAME"

DEB ?= build/joint-monitor.deb
system-python:
	@# the package brings its libraries, and takes the interpreter from where it is installed
	@$(PYTHON) -c 'import sys; sys.exit(sys.base_prefix != "/usr")' || { echo "a Debian package is for the system's own Python, not for that below $$($(PYTHON) -c 'import sys; print(sys.base_prefix)'); say it: make $(MAKECMDGOALS) PYTHON=/usr/bin/python3" >&2; exit 2; }

deb: system-python ## a Debian package of the service for this machine's release and architecture: build/joint-monitor.deb
	rm -rf build/deb
	umask 022; $(MAKE) --no-print-directory install DESTDIR=$(CURDIR)/build/deb PREFIX=/opt/joint-monitor SYSTEM=/usr/lib COMMAND=/usr/bin
	deploy/deb/build build/deb $$($(PYTHON) -c 'import re; print(re.search(r"__version__ = .(.+).", open("monitor/__init__.py").read())[1])') \
		$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])') $(DEB)
	@echo "$(DEB): for this release and architecture; there, as root: apt install ./$(notdir $(DEB)), then: joint-monitor init /etc/joint-monitor/NAME.toml"

wheel: $(STAMP) ## the wheel in dist/, tried in a fresh environment: every command's help, the files of deployment, the demo's job
	rm -rf dist
	$(BIN)/python -m build --wheel --outdir dist
	deploy/try-wheel dist/*.whl $(PYTHON) constraints.txt

release: system-python wheel ## all of a release in dist/: wheel, source, Debian package tried in a chroot, checksums, and the notes from the changelog
	$(BIN)/python -m build --sdist --outdir dist
	$(MAKE) --no-print-directory deb
	cp build/joint-monitor.deb dist/joint-monitor_$$(dpkg-deb -f build/joint-monitor.deb Version)_$$(dpkg-deb -f build/joint-monitor.deb Architecture).deb
	awk '/^## /{part++} part==1' docs/CHANGELOG.md > dist/NOTES.md
	deploy/try-deb dist/*.deb
	cd dist && sha256sum *.whl *.tar.gz *.deb > SHA256SUMS
	@ls -l dist

user: ## for you alone, without developers' tools: a virtual environment in ~/.local/share, the command in ~/.local/bin
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "joint-monitor needs Python 3.11 or newer; say which: make PYTHON=python3.11 ..." >&2; exit 2; }
	$(PYTHON) -m venv $(HOME)/.local/share/joint-monitor
	$(HOME)/.local/share/joint-monitor/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --upgrade '.[archive,gateway]'
	install -d $(HOME)/.local/bin
	ln -sfn $(HOME)/.local/share/joint-monitor/bin/joint-monitor $(HOME)/.local/bin/joint-monitor
	@echo "installed: joint-monitor --help (is $(HOME)/.local/bin in your PATH?); next: joint-monitor try, or joint-monitor init"

uninstall: ## the program and its unit, not what it has learnt: /etc/joint-monitor and /var/lib/joint-monitor stay
	@# stop knows patterns; disable does not, and takes the template for all of its instances
	test -n "$(DESTDIR)" -o ! -d /run/systemd/system || { systemctl stop 'joint-monitor@*.service' joint-monitor-plant.service joint-monitor-gateway.service; systemctl disable joint-monitor@.service joint-monitor-plant.service joint-monitor-gateway.service || true; }
	rm -rf $(INTO)
	rm -f $(DESTDIR)$(SYSTEM)/systemd/system/joint-monitor-plant.service $(DESTDIR)$(SYSTEM)/systemd/system/joint-monitor-gateway.service
	rm -f $(DESTDIR)$(SYSTEM)/systemd/system/joint-monitor@.service $(DESTDIR)$(COMMAND)/joint-monitor
	rm -f $(DESTDIR)$(SYSTEM)/sysusers.d/joint-monitor.conf $(DESTDIR)$(SYSTEM)/tmpfiles.d/joint-monitor.conf
	test -n "$(DESTDIR)" -o ! -d /run/systemd/system || systemctl daemon-reload
	@echo "uninstalled; history and configurations stay in /var/lib/joint-monitor and /etc/joint-monitor, and the user joint-monitor with them"

clean: ## remove the virtual environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build dist
