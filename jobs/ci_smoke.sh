#!/usr/bin/env bash
# The smallest whole study: a walking map on both engines, its table and its picture. Minutes on two cores.
set -euo pipefail
out=${1:-results/ci_smoke}
sweep run study=ci_smoke out="$out"
sweep table "$out"
sweep report "$out"
