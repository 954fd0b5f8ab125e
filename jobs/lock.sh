#!/usr/bin/env bash
# requirements.lock: every package that a base install needs, with hashes, at the versions of constraints.txt; for all
# supported Pythons. It names no index: `pip install --require-hashes -r requirements.lock`. Needs uv.
set -euo pipefail
cd "$(dirname "$0")/.."
uv pip compile -q pyproject.toml --universal --python-version 3.12 --generate-hashes --no-header --no-annotate \
  --no-emit-index-url --no-emit-find-links -c constraints.txt -o requirements.lock
if grep -n '://' requirements.lock; then echo "jobs/lock.sh: requirements.lock names an address" >&2; exit 1; fi
