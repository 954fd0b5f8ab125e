#!/usr/bin/env bash
# How likely walking and climbing still work with errors of every kind: the rate along each, and the error at which it
# falls to 90 %. 16000 rollouts: two minutes on a GPU, a quarter of an hour on two cores (study.design.num=32: a quarter).
set -euo pipefail
out=${1:-results}
for study in robustness_walk robustness_pole; do
  sweep run study=$study out="$out/$study" study.invalid_max=1 "${@:2}"
  sweep stats "$out/$study"
  sweep report "$out/$study"
done
