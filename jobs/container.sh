#!/usr/bin/env bash
# Build the image of the wheel in dist/ by docker, and try it as a user without a home: a rollout, a first study and its page.
#   jobs/container.sh [cpu|cuda]; ENGINE=podman builds by podman
set -euo pipefail
cd "$(dirname "$0")/.."
target=${1:-cpu} engine=${ENGINE:-docker}
"$engine" build --target "$target" -t "sweep:$target" .
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
in_container() { "$engine" run --rm --user "$(id -u):$(id -g)" -v "$work:/work" -w "/work/$1" "sweep:$target" "${@:2}"; }
in_container . run scenario=walk_tripod
in_container . init lab
in_container lab run study=first
in_container lab report results/first
[ -s "$work/lab/results/first/report.html" ]
