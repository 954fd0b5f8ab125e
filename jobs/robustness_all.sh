#!/usr/bin/env bash
# The first table of docs/robustness.md, and its rates: every manoeuvre with errors of one kind at a time, that believes what it
# is told, and that calibrates itself and touches. Half a million rollouts: 20 minutes on a GPU, on which JOBS studies run at a time.
#   nvidia-cuda-mps-control -d     # lets studies share a GPU at one time, of which each fills a part
#   JOBS=12 jobs/robustness_all.sh results/robustness_all [SCENARIO ...]
# Started again with the same arguments it finishes what is missing.
set -euo pipefail
out=${1:-results/robustness_all}
scenarios=("${@:2}")
[ ${#scenarios[@]} -gt 0 ] || scenarios=(ball_balance ball_climb ball_descend ball_drive ball_ledges ball_over ball_to_ball beam_cross
  corner_climb corner_full ladder_climb ladder_descend pole_climb pole_descent pole_ledge_above pole_ledge_below pole_ledge_level
  pole_return pole_round pole_top raft_cross raft_stand walk_kerb)
export XLA_PYTHON_CLIENT_PREALLOCATE=false  # several studies share a GPU's memory

ground() {  # the obstacle's own sizes that are wrong together
  case $1 in
    pole_*) echo radius height ledge_height ;;
    corner_*) echo half_angle height ;;
    walk_kerb) echo height ;;
    beam_*) echo width height ;;
    ladder_*) echo rung_step ledge_height ;;
    raft_*) echo length width density water_width ;;
    ball_ledges) echo radius height ;;
    ball_*) echo radius mass ;;
  esac
}

learning() {  # what makes it learn; nothing where it cannot
  case $1 in
    ball_balance | raft_stand) ;;
    ball_drive) echo control.touch=obstacle manoeuvre.speed_integral=0.05 ;;
    ball_descend | ball_to_ball) echo control.touch=obstacle ;;
    ball_*) echo control=calibrate control.touch=obstacle ;;
    raft_cross) echo control=calibrate ;;
    *) echo control=learn ;;
  esac
}

one() {  # FOLDER STUDY SCENARIO [OVERRIDE ...]
  local folder=$1 study=$2 scenario=$3
  local given=("study=$study" "scenario=$scenario" study.seed=41 scenario.expect=[] "${@:4}")
  [[ $scenario != corner_* ]] || given+=(contact.friction=1.2)
  if [ "$study" = any_robustness ]; then
    given+=("+study.axes.ground_error={nominal: 0.0, values: [0.0025, 0.005, 0.01, 0.02, 0.04]}")
    for size in $(ground "$scenario"); do
      given+=("+study.axes.ground_$size={path: obstacle.$size, side: world, relative: ground_error}")
    done
  fi
  ${SWEEP:-sweep} run "${given[@]}" "out=$folder" > "$folder.txt" 2>&1 || echo "$folder: exit $?: $(tail -1 "$folder.txt")"
}
export -f one ground

mkdir -p "$out"
for scenario in "${scenarios[@]}"; do
  case $scenario in ball_* | raft_* | ladder_*) seen=any_seeing ;; *) seen=any_rates ;; esac
  for study in any_robustness $seen; do
    printf '%s\n' "$out/$scenario-$study $study $scenario"
    given=$(learning "$scenario")
    [ -z "$given" ] || printf '%s\n' "$out/$scenario-$study-learns $study $scenario $given"
  done
done | xargs -P "${JOBS:-1}" -I{} bash -c 'one {}'
