#!/usr/bin/env bash
#SBATCH --job-name=sweep --requeue --open-mode=append --signal=B:USR1@120
# The walking map on a Slurm cluster: run it on a login node, or `sbatch jobs/slurm.sh` where those must stay idle. One job
# for each worker, a GPU each; Slurm starts them when it can, and a job that meets its time limit is sent again.
#   jobs/slurm.sh [FOLDER [key=value ...]], such as jobs/slurm.sh results/fine study.axes.friction.num=512 cluster.workers=8
# The folder must be on a file system that the nodes share. `cluster.interface=ib0` names their network where it has several.
# SWEEP_IMAGE=sweep.sif runs Apptainer's image of packaging/sweep.def instead of an installed `sweep`: one job, such as
# `SWEEP_IMAGE=sweep.sif sbatch --gres=gpu:4 jobs/slurm.sh`, with all GPUs of its node and no workers, as no image has Slurm's
# sbatch. Apptainer shows it the home and the working folder; APPTAINER_BIND=/scratch adds others.
# A batch job requeues itself when its time limit nears (USR1, 120 s before) or another job preempts it (USR1 or TERM);
# its next start simulates only what is missing. The folder must be an absolute path then, or relative to where sbatch ran.
set -euo pipefail
out=${1:-results/walk_map_slurm}

run=
requeue() {
  trap '' USR1 TERM
  if [ -n "$run" ]; then
    kill -INT "$run" 2>/dev/null || true  # finished rollouts stay, and worker jobs are cancelled
    wait "$run" || true
  fi
  scontrol requeue "$SLURM_JOB_ID"
  exit 0
}
[ -z "${SLURM_JOB_ID:-}" ] || trap requeue USR1 TERM

sweep=(sweep)
workers=(cluster=slurm cluster.workers=4 cluster.cores=4 cluster.memory=16GB cluster.walltime=02:00:00
  "cluster.logs=$out/slurm" 'cluster.directives=["--gres=gpu:1"]')
if [ -n "${SWEEP_IMAGE:-}" ]; then
  sweep=(apptainer exec --nv "$SWEEP_IMAGE" sweep)
  workers=(cluster=local)
fi

set -m  # otherwise bash would let the command ignore SIGINT
"${sweep[@]}" run study=walk_map out="$out" engine.width=8192 "${workers[@]}" "${@:2}" &
run=$!
wait "$run"
"${sweep[@]}" report "$out"
