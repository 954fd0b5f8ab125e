#!/usr/bin/env bash
# What whoever installs the package gets: sdist and wheel (left in dist/), the wheel alone in an empty environment of
# each Python that is named, and a newcomer's first commands in an empty folder; with the first Python, the tutorials too.
# `make wheel` names the Pythons found.
# WITH='mujoco==4.*' replaces a locked version.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
unset PYTHONPATH VIRTUAL_ENV
export MPLBACKEND=agg

rm -rf "$root"/dist "$root"/*.egg-info  # a list of sources of builds before would hide what is not found
"$root/.venv/bin/python" -m build --no-isolation --outdir "$root/dist" "$root" >"$work/build.log" 2>&1 || { cat "$work/build.log"; exit 1; }

for name in "$@"; do
  cd "$root"  # a pyenv's shim picks its Python by the folder that it is called from
  python=$("$name" -c 'import sys; print(sys.executable)')
  echo "== $("$python" --version): $(basename "$root"/dist/*.whl)"
  rm -rf "$work/env" "$work/empty"
  mkdir "$work/empty"
  cd "$work/empty"
  PYTHON=$python bash "$root/packaging/install.sh" "$root" "$work/env"
  if [ -n "${WITH:-}" ]; then
    "$work/env/bin/pip" uninstall -q -y "${WITH%%[=<>~]*}"  # MuJoCo 4 is several packages: an upgrade in place removes files of theirs
    "$work/env/bin/pip" install -q "$WITH"
    "$work/env/bin/pip" check
  fi
  sweep() { "$work/env/bin/sweep" "$@"; }
  sweep run scenario=walk_tripod
  sweep run scenario=raft_cross
  sweep init lab
  cd lab
  sweep run study=first
  sweep report results/first
  "$work/env/bin/python" -c '
from sweep import load, run
assert len(run("scenario=walk_tripod")) == 1
assert len(load("results/first", "friction > 0.1")) > 8'
  if [ "$name" = "$1" ]; then
    SWEEP_WHEEL_ENV="$work/env" "$root/.venv/bin/python" -m pytest -q -p no:cacheprovider -m wheel "$root/tests/test_tutorials.py"
  fi
  # which code rows are from is known away from a checkout too
  [ ! -e "$root/.git" ] || grep -q "^commit: [0-9a-f'\"]" results/first/study.yaml
done
