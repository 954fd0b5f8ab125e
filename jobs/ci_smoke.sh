#!/usr/bin/env bash
# The smallest whole study: a walking map on both engines, its table and its picture. Minutes on two cores.
# With a folder to compare with, such as tests/data/ci_smoke, exit code 4 says that outcomes or figures have changed.
set -euo pipefail
out=${1:-results/ci_smoke} before=${2:-}
sweep run study=ci_smoke out="$out"
sweep table "$out"
sweep report "$out"
# paired by what is swept, as a new parameter renames all points;
# one rollout at the boundary may flip by rounding alone; typical figures move by far less than a tenth
if [ -n "$before" ]; then sweep compare "$before" "$out" --by engine.name,friction,half_step_ratio --tolerance 0.03 --figures 0.1; fi
