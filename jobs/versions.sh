#!/usr/bin/env bash
# The fast tests with other versions of the dependencies than constraints.txt pins, in environments under build/versions.
#   jobs/versions.sh lowest|newest PYTHON [pytest arguments ...], such as jobs/versions.sh newest python3.13 tests/models
# `lowest` takes the lower bounds of pyproject.toml, `newest` the newest versions that it allows, pre-releases too. Needs uv.
set -euo pipefail
cd "$(dirname "$0")/.."
which=$1 python=$2
shift 2
name=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
env=build/versions/$which-$name
uv venv -q --clear --python "$python" "$env"
case $which in
  lowest) how=(--resolution lowest-direct) ;;
  newest) how=(--prerelease allow --upgrade) ;;
  *) echo "jobs/versions.sh: $which is not allowed: lowest or newest" >&2; exit 2 ;;
esac
uv pip install -q --python "$env/bin/python" "${how[@]}" .
uv pip freeze --python "$env/bin/python" | grep -v '^insect-sweep' >"$env/versions.txt"  # the tests' own tools may be newer
uv pip install -q --python "$env/bin/python" -c "$env/versions.txt" -e . --group test
"$env/bin/python" - <<'PYTHON'
from importlib.metadata import version
print(*(f"{name} {version(name)}" for name in ("jax", "mujoco", "mujoco-mjx", "numpy", "pandas", "scipy", "pyarrow")), sep=", ")
PYTHON
"$env/bin/python" -m pytest -q -n 2 "$@"
