# Everything that a fresh machine needs Rust for and nothing else, but where a target says so.
CARGO ?= cargo
VENV := .venv
PYTHON := $(VENV)/bin/python
PAGE := crates/serve/page/index.html
PAGE_SOURCES := web/index.html web/package.json web/svelte.config.js web/vite.config.ts \
	$(shell find web/src web/public -type f ! -name message.ts 2>/dev/null)

# Everything that tests run is built once, in one profile and always of the whole workspace: another choice
# of packages has other features and builds anew what they have in common. `make python BUILD=release` tests
# what is shipped.
BUILD ?= debug
PROFILE := $(if $(filter debug,$(BUILD)),dev,$(BUILD))
WORKSPACE := --workspace --locked --quiet --profile $(PROFILE)
# Tests that start processes run two at a time, on any machine (BUILD-3).
PYTEST := POLEPAIR_BUILD=$(BUILD) $(CURDIR)/$(PYTHON) -m pytest -n 2 --dist loadfile
# Runs a step of `make test` and says how long it took.
STEP := .ci/step
# The Python module, and where it is installed for tests.
MODULE := lib_polepair.$(if $(filter Darwin,$(shell uname)),dylib,so)
SITE = $(shell $(PYTHON) -c 'import sysconfig; print(sysconfig.get_path("purelib"))')

.PHONY: demo test installing-steps checking-steps process-steps client-steps unit-step page-step \
	windows-step wine-step documentation-steps check quick-tests instructions lints features dependencies spelling build packages web \
	page-units page page-tests site site-pages interop windows windows-tests windows-program windows-files macos \
	package python python-tests python-command wheel deb dist try-dist swarm threads soak bench coverage release clean

# It is built soon rather than fast (BUILD-5).
## demo: the main job on simulated drives, then the page with such drives; HEADLESS=1 ends by itself
demo:
	@if web/ready; then $(MAKE) --no-print-directory $(PAGE) || echo "page: left out" >&2; fi
	$(CARGO) build --profile demo --locked -p polepair-cli --no-default-features
	target/demo/polepair demo $(if $(HEADLESS),--headless)
	@if [ -z "$(HEADLESS)" ] && [ -t 1 ]; then target/demo/polepair serve --bind 127.0.0.1:0; fi

## test: all tests, 500 swarm seeds and 200 of gateways among them; installs what the foreign clients need
test:
	@$(STEP) --begin
	@$(MAKE) --no-print-directory -j2 --output-sync=line installing-steps checking-steps
	@$(STEP) "build" $(MAKE) package
	@$(MAKE) --no-print-directory -j4 --output-sync=line process-steps client-steps documentation-steps wine-step
	@$(MAKE) --no-print-directory page-step
	@$(STEP) --table

# Steps of `make test` run side by side, so that both cores compute while tests wait (BUILD-4).
installing-steps:
	@$(STEP) "packages" $(MAKE) packages
	@$(STEP) "page's unit tests" $(MAKE) page-units

checking-steps:
	@$(STEP) "lints" $(MAKE) lints
	@$(STEP) "features" $(MAKE) features
	@$(STEP) "dependencies" $(MAKE) dependencies spelling

# Tests that contain both ends of the wire get longer time-outs from here (BUILD-3).
process-steps:
	@$(STEP) "integration tests" env RUST_TEST_THREADS=2 POLEPAIR_TIMEOUT_SCALE=3 $(CARGO) test $(WORKSPACE) --no-fail-fast --test '*'

client-steps:
	@$(STEP) "python" $(MAKE) python-tests python-command
	@$(STEP) "interop" env $(PYTEST) interop --ignore interop/test_windows.py

unit-step:
	@$(STEP) "unit tests" $(CARGO) test $(WORKSPACE) --no-fail-fast --lib --bins

page-step:
	@$(STEP) "page" $(MAKE) page-tests

windows-step: unit-step
	@$(STEP) "Windows" $(MAKE) windows-program

wine-step: windows-step
	@$(STEP) "tests under Wine" $(MAKE) windows-tests

documentation-steps: windows-step
	@$(STEP) "documentation" $(MAKE) site-pages
	@$(STEP) "doc tests" $(CARGO) test $(WORKSPACE) --doc

## check: format, lints, licences, spelling, unit tests (tidiness and generated files are among them), captures mutated for seconds, instructions for each decoded frame
check:
	@$(MAKE) --no-print-directory -j2 --output-sync=target quick-tests lints dependencies spelling
	@$(MAKE) --no-print-directory instructions

# They are built first, and run beside the lints.
quick-tests:
	POLEPAIR_SEEDS=100 POLEPAIR_READER_SECONDS=0.5 $(CARGO) test $(WORKSPACE) --lib --bins --test readers

# Left out where valgrind is not installed, and with another compiler than that of the committed counts.
instructions:
	$(CARGO) run --locked --quiet --package xtask -- instructions

lints:
	$(CARGO) fmt --all --check
	$(CARGO) clippy --workspace --all-targets --locked --quiet -- -D warnings

# What `make demo` builds, without the features that take long.
features:
	$(CARGO) clippy --package polepair-cli --no-default-features --locked --quiet -- -D warnings

# Licences and origins of what the project depends on (deny.toml).
dependencies:
	packaging/install-tools cargo-deny
	target/tools/bin/cargo-deny --log-level error check bans licenses sources

# Misspelled words in code and documents (.codespellrc). Left out where Python has no venv.
spelling:
	@packaging/install-codespell && target/tools/codespell/bin/codespell || [ ! -e target/tools/codespell/bin/codespell ]

# Tests, the programs that they start, examples and the Python module.
build:
	$(CARGO) test $(WORKSPACE) --no-run
	$(CARGO) build $(WORKSPACE) --lib --bins --examples

# What tests need beside Rust, and the page, which the server contains.
packages: $(VENV)/ready
	-@rustup target add thumbv6m-none-eabi >/dev/null 2>&1 || true
	@if web/ready; then $(MAKE) --no-print-directory $(PAGE); fi

## web: the dashboard's page, checked, tried and built into crates/serve/page; needs Node.js
web: $(PAGE)
	$(MAKE) --no-print-directory page-units

page-units:
	@if web/ready; then cd web && npm run --silent check && npm run --silent unit -- --reporter=dot; fi

$(PAGE): web/node_modules/.package-lock.json $(PAGE_SOURCES)
	cd web && npm run --silent build -- --logLevel warn

web/node_modules/.package-lock.json: web/package-lock.json
	cd web && npm ci --silent --no-audit --no-fund
	touch $@

## page: the page in a real browser on the real server, where both are; IMAGES=docs/images takes its pictures anew, TESTS=scope tries a part
page:
	interop/install-debian-packages
	@if web/ready; then $(MAKE) --no-print-directory web; fi
	$(MAKE) --no-print-directory build
	$(MAKE) --no-print-directory page-tests

page-tests:
	@if web/ready browser; then cd web && POLEPAIR_BUILD=$(BUILD) IMAGES=$(abspath $(IMAGES)) npm run --silent page -- $(TESTS); fi

## site: the documentation as web pages in target/site, with the interfaces of Rust and Python; all links checked
site: package
	$(MAKE) --no-print-directory site-pages

site-pages:
	packaging/install-tools mdbook
	RUSTDOCFLAGS='-D warnings' $(CARGO) doc --workspace --no-deps --locked --quiet
	rm -rf target/site
	MDBOOK_LOG=warn target/tools/bin/mdbook build docs
	$(PYTHON) -m pdoc --output-directory target/site/api/python polepair '!polepair._polepair' '!polepair.__main__'
	cp -r target/doc target/site/api/rust
	target/$(BUILD)/xtask links target/site

## interop: foreign hosts against our drives, our hosts against foreign drives
interop: package windows-program
	$(PYTEST) interop

## windows: the program for Windows, tried under Wine against drives of this machine; needs mingw-w64 and Wine
windows: package windows-program
	$(MAKE) --no-print-directory windows-tests

windows-tests:
	$(PYTEST) interop/test_windows.py

windows-program:
	interop/install-debian-packages interop/windows/debian-packages.txt
	@if interop/windows/ready; then $(MAKE) --no-print-directory windows-files; fi

windows-files: $(VENV)/ready
	$(CARGO) build -p polepair-cli -p polepair-python -p polepair-ffi -p polepair-tml-compat --locked --quiet \
		--profile $(PROFILE) --target x86_64-pc-windows-gnu
	interop/windows/wheel $(BUILD)

## macos: the crates that need no linker, checked for macOS; nothing is run
macos:
	rustup target add x86_64-apple-darwin >/dev/null 2>&1 || true
	$(CARGO) check --locked --quiet --target x86_64-apple-darwin \
		-p polepair-core -p polepair-drives -p polepair-sim -p polepair-link -p polepair

# Installed as `maturin develop` would, but from the workspace's build.
package: $(VENV)/ready build
	cp target/$(BUILD)/$(MODULE) crates/python/python/polepair/_polepair.abi3.so
	cd crates/python && $(CURDIR)/$(VENV)/bin/maturin pep517 write-dist-info --metadata-directory $(SITE) \
		>$(CURDIR)/target/maturin.log 2>&1 || { cat $(CURDIR)/target/maturin.log; false; }
	printf '%s\n' $(CURDIR)/crates/python/python $(CURDIR)/crates/test-support/python >$(SITE)/polepair.pth
	$(PYTHON) .ci/install-command polepair polepair.__main__:main

## python: the package, built and tried: its surface, its types, its guide, examples and notebooks
python: package
	$(MAKE) --no-print-directory python-tests
	$(MAKE) --no-print-directory python-command

python-tests:
	cd crates/python && $(CURDIR)/$(PYTHON) -m mypy
	cd crates/python && $(CURDIR)/$(PYTHON) -m mypy --strict --config-file pyproject.toml ../../examples/python/*.py
	cd crates/python && $(CURDIR)/$(PYTHON) -m pyright --pythonpath $(CURDIR)/$(PYTHON)
	cd crates/python && $(CURDIR)/$(PYTHON) -m mypy.stubtest polepair --ignore-missing-stub --allowlist stubtest-allowed.txt --ignore-unused-allowlist --mypy-config-file pyproject.toml
	cd crates/python && $(PYTEST)

python-command:
	RUST_TEST_THREADS=2 POLEPAIR_COMMAND=$(CURDIR)/$(VENV)/bin/polepair $(CARGO) test $(WORKSPACE) --test commands -- ctrl_c_stops every_signal a_terminal_that holds_the_port

# Tools that build what users install.
$(VENV)/packaging: $(VENV)/ready packaging/requirements.txt packaging/tools.txt
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -r packaging/requirements.txt
	packaging/install-tools cargo-deb cargo-sbom
	touch $@

## wheel: the Python package with the command and the page, for glibc 2.28 and newer, and its source distribution
wheel: $(PAGE) $(VENV)/packaging
	packaging/build wheel

## deb: the Debian packages: command, man pages, completions, udev rules, systemd unit; C library and headers
deb: $(PAGE) $(VENV)/packaging
	packaging/build program
	packaging/build deb
	packaging/build library

## dist: wheel, Debian packages, archives for glibc, musl and Windows, lists of parts (SBOM) and check sums, in dist/
dist: wheel deb
	packaging/build archive
	interop/install-debian-packages interop/windows/debian-packages.txt
	packaging/build windows
	packaging/build sums

## try-dist: what is in dist/, installed in a fresh environment and in a fresh root, used and removed
try-dist: $(VENV)/packaging
	interop/install-debian-packages packaging/debian-packages.txt
	$(PYTEST) packaging

$(VENV)/ready: interop/requirements.txt interop/source-distributions.txt interop/debian-packages.txt
	interop/install-debian-packages
	interop/install-debian-packages interop/octave-packages.txt --no-install-recommends
	python3 -m venv $(VENV)
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -r interop/requirements.txt
	$(PYTHON) -m pip download --quiet --disable-pip-version-check --no-deps --no-binary :all: \
		--dest $(VENV)/sources -r interop/source-distributions.txt
	touch $@

## swarm: seeded worlds of hosts, drives, gateways and faults; SEEDS=100000 and GATEWAY_SEEDS=10000 for more
swarm:
	$(CARGO) run --release --quiet --package xtask -- swarm --seeds $(or $(SEEDS),8000)
	$(CARGO) run --release --quiet --package xtask -- swarm --on gateway --seeds $(or $(GATEWAY_SEEDS),$(SEEDS),8000)

THREADS := target/threads
## threads: the C interface under ThreadSanitizer, with a standard library built for it: 8 threads, 100,000 rounds; needs clang and rust-src
threads:
	rustup component add rust-src >/dev/null 2>&1 || true
	RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Zsanitizer=thread $(CARGO) build -Zbuild-std --target x86_64-unknown-linux-gnu \
		--target-dir $(THREADS) --locked --quiet -p polepair-ffi
	clang -g -O1 -fsanitize=thread -I crates/ffi/include -c crates/ffi/tests/integration/rules.c -o $(THREADS)/rules.o
	g++ -o $(THREADS)/rules $(THREADS)/rules.o $(THREADS)/x86_64-unknown-linux-gnu/debug/libpolepair_ffi.a \
		-Wl,--whole-archive $$(find $$(rustc --print sysroot) -name 'librustc*_rt.tsan.a') -Wl,--no-whole-archive \
		-lm -lpthread -ldl -lgcc_s -lrt
	$(THREADS)/rules $(or $(ROUNDS),12500)

## soak: the long forms of what `make test` samples
soak:
	POLEPAIR_GARBAGE=1000000 $(CARGO) test --release --locked --quiet -p polepair-sim garbage -- --nocapture
	POLEPAIR_EXCHANGES=1000000 $(CARGO) test --release --locked --quiet -p polepair-link --test integration stress:: -- --nocapture
	POLEPAIR_BUS_SECONDS=3600 $(CARGO) test --release --locked --quiet -p polepair-sim --test integration mixed:: -- --nocapture
	POLEPAIR_SCOPE_SECONDS=600 $(CARGO) test --release --locked --quiet -p polepair-serve --test integration telemetry:: -- --nocapture
	POLEPAIR_SCOPE_SECONDS=600 POLEPAIR_SPEED=1 $(MAKE) --no-print-directory page BUILD=release TESTS="scope page"
	POLEPAIR_LOAD_RUNS=5 POLEPAIR_LOAD_VIEWERS=100 POLEPAIR_LOAD_COMMANDS=2000 POLEPAIR_LOAD_STOPS=2000 POLEPAIR_LOAD_IDLE=10000 $(CARGO) test --release --locked --quiet -p polepair-cli --test commands gateway::load:: -- --ignored --nocapture
	POLEPAIR_FRAMES=all $(CARGO) test --release --locked --quiet -p polepair-cli --lib every_frame
	POLEPAIR_READER_SECONDS=600 $(CARGO) test --release --locked --quiet -p polepair-capture --test readers
	POLEPAIR_FRAMES=all POLEPAIR_MANY_SECONDS=300 POLEPAIR_LEAK_CALLS=2000000 $(MAKE) --no-print-directory python BUILD=release
	$(CARGO) test --release --locked --quiet -p polepair-sim --test pinned
	POLEPAIR_BLOCK_BYTES=2000000 POLEPAIR_WIRESHARK_FRAMES=1000000 POLEPAIR_FLEET_CAPTURES=200 $(MAKE) --no-print-directory interop BUILD=release
	$(CARGO) package --workspace --locked --quiet
	$(MAKE) --no-print-directory dist try-dist
	$(MAKE) --no-print-directory swarm SEEDS=1000000 GATEWAY_SEEDS=100000
	$(MAKE) --no-print-directory threads
	fuzz/run $(or $(FUZZ_SECONDS),60)

## coverage: lines of the crates that the unit tests execute, as a table and as target/lcov.info
coverage:
	rustup component add llvm-tools >/dev/null
	packaging/install-tools cargo-llvm-cov
	POLEPAIR_SEEDS=100 PATH="$(CURDIR)/target/tools/bin:$$PATH" $(CARGO) llvm-cov test --locked --quiet --workspace \
		--lib --bins --no-report
	PATH="$(CURDIR)/target/tools/bin:$$PATH" $(CARGO) llvm-cov report --lcov --output-path target/lcov.info
	PATH="$(CURDIR)/target/tools/bin:$$PATH" $(CARGO) llvm-cov report --summary-only

## release: a commit and a tag for VERSION=X.Y.Z, with the changes of `changes/` in the changelog; nothing is uploaded; with --dry-run what would be
release:
	+@$(CARGO) run --quiet --locked --package xtask -- release "$(VERSION)" $(if $(findstring n,$(firstword -$(MAKEFLAGS))),--dry-run)

## bench: the codecs, the layers, the round trip beside the raw pty
bench:
	$(CARGO) bench --locked -p polepair-core -p polepair-drives -p polepair-link

clean:
	$(CARGO) clean
	rm -rf $(VENV) interop/build crates/serve/page web/node_modules
