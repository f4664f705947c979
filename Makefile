# Everything that a fresh machine needs Rust for and nothing else, but where a target says so.
CARGO ?= cargo
VENV := .venv
PYTHON := $(VENV)/bin/python
PAGE := web/dist/index.html
PAGE_SOURCES := web/index.html web/package.json web/svelte.config.js web/vite.config.ts \
	$(shell find web/src web/public -type f ! -name message.ts 2>/dev/null)

# What tests want in release: always all of it by the same words, for another choice of packages has other
# features and builds anew what they have in common.
RELEASE := --release --locked --quiet -p polepair-cli -p polepair -p polepair-link -p polepair-sim

.PHONY: demo test check web page interop package python swarm soak bench clean

## demo: the main job on simulated drives, then the page with such drives; HEADLESS=1 ends by itself
demo:
	@if web/ready; then $(MAKE) --no-print-directory $(PAGE) || echo "page: left out" >&2; fi
	$(CARGO) build --release --locked -p polepair-cli
	target/release/polepair demo $(if $(HEADLESS),--headless)
	@if [ -z "$(HEADLESS)" ] && [ -t 1 ]; then target/release/polepair serve --bind 127.0.0.1:0; fi

## test: all tests, 500 swarm seeds and 200 of gateways among them; installs what the foreign clients need
test: check
	-@rustup target add thumbv6m-none-eabi >/dev/null 2>&1 || true
	$(CARGO) build --workspace --locked --quiet --examples
	$(CARGO) test --workspace --locked --quiet --test '*'
	$(CARGO) test --workspace --locked --quiet --doc
	$(CARGO) test $(RELEASE) --test pinned
	RUSTDOCFLAGS='-D warnings' $(CARGO) doc --workspace --no-deps --locked --quiet
	$(MAKE) --no-print-directory page interop python

## check: format, lints, unit tests (tidiness and generated files are among them), captures mutated for seconds
check:
	$(CARGO) fmt --all --check
	$(CARGO) clippy --workspace --all-targets --locked --quiet -- -D warnings
	$(CARGO) test --workspace --locked --quiet --lib --bins --test readers

## web: the dashboard's page, checked, tried and built into web/dist; needs Node.js
web: $(PAGE)
	cd web && npm run --silent check
	cd web && npm run --silent unit -- --reporter=dot

$(PAGE): web/node_modules/.package-lock.json $(PAGE_SOURCES)
	cd web && npm run --silent build -- --logLevel warn

web/node_modules/.package-lock.json: web/package-lock.json
	cd web && npm ci --silent --no-audit --no-fund
	touch $@

## page: the page in a real browser on the real server, where both are; IMAGES=docs/images takes its pictures anew, TESTS=scope tries a part
page:
	interop/install-debian-packages
	@if web/ready; then $(MAKE) --no-print-directory web; fi
	$(CARGO) build $(RELEASE) --bin polepair --examples
	@if web/ready browser; then cd web && IMAGES=$(abspath $(IMAGES)) npm run --silent page -- $(TESTS); fi

## interop: foreign hosts against our drives, our hosts against foreign drives
interop: package
	$(CARGO) build $(RELEASE) --bin polepair --examples
	$(PYTHON) -m pytest interop

package: $(VENV)/ready
	VIRTUAL_ENV=$(CURDIR)/$(VENV) $(VENV)/bin/maturin develop --release --quiet --manifest-path crates/python/Cargo.toml

## python: the package, built and tried: its surface, its types, its guide, examples and notebooks
python: package
	$(CARGO) build $(RELEASE) --bin polepair --examples
	cd crates/python && $(CURDIR)/$(PYTHON) -m mypy
	cd crates/python && $(CURDIR)/$(PYTHON) -m mypy --strict --config-file pyproject.toml ../../examples/python/*.py
	cd crates/python && $(CURDIR)/$(PYTHON) -m pyright --pythonpath $(CURDIR)/$(PYTHON)
	cd crates/python && $(CURDIR)/$(PYTHON) -m mypy.stubtest polepair --ignore-missing-stub --allowlist stubtest-allowed.txt --ignore-unused-allowlist --mypy-config-file pyproject.toml
	cd crates/python && $(CURDIR)/$(PYTHON) -m pytest

$(VENV)/ready: interop/requirements.txt interop/debian-packages.txt
	interop/install-debian-packages
	python3 -m venv $(VENV)
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -r interop/requirements.txt
	touch $@

## swarm: seeded worlds of hosts, drives, gateways and faults; SEEDS=100000 for more
swarm:
	$(CARGO) run --release --quiet --package xtask -- swarm --seeds $(or $(SEEDS),8000)
	$(CARGO) run --release --quiet --package xtask -- swarm --on gateway --seeds $(or $(SEEDS),8000)

## soak: the long forms of what `make test` samples
soak:
	POLEPAIR_GARBAGE=1000000 $(CARGO) test --release --locked --quiet -p polepair-sim garbage -- --nocapture
	POLEPAIR_EXCHANGES=1000000 $(CARGO) test --release --locked --quiet -p polepair-link --test integration stress:: -- --nocapture
	POLEPAIR_BUS_SECONDS=3600 $(CARGO) test --release --locked --quiet -p polepair-sim --test integration mixed:: -- --nocapture
	POLEPAIR_SCOPE_SECONDS=600 $(CARGO) test --release --locked --quiet -p polepair-serve --test integration telemetry:: -- --nocapture
	POLEPAIR_SCOPE_SECONDS=600 $(MAKE) --no-print-directory page TESTS=scope
	POLEPAIR_LOAD_RUNS=5 POLEPAIR_LOAD_COMMANDS=2000 POLEPAIR_LOAD_STOPS=2000 POLEPAIR_LOAD_IDLE=10000 $(CARGO) test --release --locked --quiet -p polepair-cli --test integration gateway::load:: -- --nocapture
	POLEPAIR_FRAMES=all $(CARGO) test --release --locked --quiet -p polepair-cli --bin polepair every_frame
	POLEPAIR_READER_SECONDS=600 $(CARGO) test --release --locked --quiet -p polepair-capture --test readers
	POLEPAIR_MANY_SECONDS=300 POLEPAIR_LEAK_CALLS=2000000 $(MAKE) --no-print-directory python
	$(MAKE) --no-print-directory swarm SEEDS=100000
	fuzz/run $(or $(FUZZ_SECONDS),60)

## bench: the codecs, the layers, the round trip beside the raw pty
bench:
	$(CARGO) bench --locked -p polepair-core -p polepair-link

clean:
	$(CARGO) clean
	rm -rf $(VENV) interop/build web/dist web/node_modules
