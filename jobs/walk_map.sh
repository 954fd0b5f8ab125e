#!/usr/bin/env bash
# Walking over ground friction and step length: 561 rollouts on two cores, or refined on a GPU, e.g.
#   jobs/walk_map.sh results/walk_map_fine study.axes.friction.num=128 study.axes.step.num=64 engine.width=8192
# Started again with the same arguments it finishes what is missing.
set -euo pipefail
out=${1:-results/walk_map}
sweep run study=walk_map out="$out" "${@:2}"
sweep table "$out" --format csv -o "$out/table.csv"
sweep report "$out"
