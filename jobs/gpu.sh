#!/usr/bin/env bash
# The walking map refined to 131072 points on the GPUs of this machine, which share each batch (extra `gpu`).
# Where a batch does not fit in their memory its width is halved; engine.width sets one.
set -euo pipefail
out=${1:-results/walk_map_gpu}
sweep run study=walk_map out="$out" study.axes.friction.num=512 study.axes.step.num=256 "${@:2}"
sweep report "$out"
