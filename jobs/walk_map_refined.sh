#!/usr/bin/env bash
# The walking map refined to 129 x 129 points, against the whole grid of them (hours on two cores, minutes on a GPU).
set -euo pipefail
out=${1:-results/walk_map_refined}
sweep run study=walk_map_refined out="$out" "${@:2}"
sweep run study=walk_map_refined out="$out"_grid study.resolution=0 study.audit=0 \
  study.axes.friction.num=129 study.axes.step.num=129 "${@:2}"
sweep report "$out"
python "$(dirname "$0")/../bench/refinement.py" "$out" "$out"_grid
