#!/usr/bin/env bash
# The walking map on a Slurm cluster: run it on a login node, or with sbatch where those must stay idle. One job for each
# worker, a GPU each; Slurm starts them when it can, and a job that meets its time limit is sent again.
#   jobs/slurm.sh [FOLDER [key=value ...]], such as jobs/slurm.sh results/fine study.axes.friction.num=512 cluster.workers=8
# The folder must be on a file system that the nodes share. `cluster.interface=ib0` names their network where it has several.
set -euo pipefail
out=${1:-results/walk_map_slurm}
sweep run study=walk_map out="$out" engine.width=8192 \
  cluster=slurm cluster.workers=4 cluster.cores=4 cluster.memory=16GB cluster.walltime=02:00:00 cluster.logs="$out/slurm" \
  'cluster.directives=["--gres=gpu:1"]' "${@:2}"
sweep report "$out"
