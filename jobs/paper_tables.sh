#!/usr/bin/env bash
# Studies as pages and as bundles for a paper: LaTeX tables, figures, their data, and a macro for every number.
#   jobs/paper_tables.sh results/paper walk_map robustness_walk
# Started again with the same arguments it finishes what is missing. The pictures need OpenGL without a screen.
set -euo pipefail
out=${1:-results/paper}
studies=("${@:2}")
for study in "${studies[@]:-walk_map}"; do
  sweep run study="$study" out="$out/$study"
  sweep report "$out/$study" --replays 60 --pictures
  sweep export "$out/$study" --paper "$out/$study/paper"
done
