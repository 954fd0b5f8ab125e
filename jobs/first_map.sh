#!/usr/bin/env bash
# A stranger's first map, timed: an empty environment, the wheel (the newest in dist/, built if there is none), one study and
# its page. Nothing is cached but packages. Prints MB of the environment and seconds of each step.
#   jobs/first_map.sh [PYTHON]; the first Python 3.12 or 3.13 on the PATH by default; uses uv where it is there, else pip
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
for python in ${1:-python3.12 python3.13 python3} ""; do
  if "$python" -c 'import sys; sys.exit(not (3, 12) <= sys.version_info[:2] < (3, 14))' 2>/dev/null; then break; fi
done
[ -n "$python" ] || { echo "jobs/first_map.sh: no Python 3.12 or 3.13 among: ${1:-python3.12 python3.13 python3}" >&2; exit 2; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
unset PYTHONPATH VIRTUAL_ENV
export MPLBACKEND=agg XDG_CACHE_HOME="$work/cache" UV_CACHE_DIR="${UV_CACHE_DIR:-$HOME/.cache/uv}"

wheel=$(ls -t "$root"/dist/*.whl 2>/dev/null | head -1 || true)
if [ -z "$wheel" ]; then
  "$root/.venv/bin/python" -m build --wheel --no-isolation --outdir "$root/dist" "$root" >/dev/null
  wheel=$(ls "$root"/dist/*.whl)
fi

cd "$work"
started=$(date +%s.%N)
before=$started
step() {
  now=$(date +%s.%N)
  printf '%-8s %6.1f s\n' "$1" "$(echo "$now - $before" | bc)"
  before=$now
}

if command -v uv >/dev/null; then
  uv venv -q --python "$python" env
  uv pip install -q --python env/bin/python -c "$root/constraints.txt" "$wheel"
else
  "$python" -m venv env
  env/bin/pip install -q -c "$root/constraints.txt" "$wheel"
fi
step install
env/bin/sweep init lab >/dev/null
cd lab
../env/bin/sweep run study=first >/dev/null
step run
../env/bin/sweep report results/first >/dev/null
step report
[ -s results/first/report.html ]
printf '%-8s %6.1f s\n' total "$(echo "$before - $started" | bc)"
echo "$(du -sm --apparent-size "$work/env" | cut -f1) MB"
