#!/usr/bin/env bash
# Does a change leave behaviour as it was? Runs the same commands with the code of a revision and with the code of the
# working tree, and compares every file that they write: recordings, bus logs, summaries, diagnoses, figures, and what
# they print. What a clock measured is left out. Some 5 minutes.
#
# usage: tools/revisions/same_bytes.sh REVISION [python]
set -euo pipefail
cd "$(dirname "$0")/../.."
tree=$PWD
base=$(git rev-parse --short "$1^{commit}")
python=${2:-$tree/.venv/bin/python}
work=$tree/build/same-bytes
rm -rf "$work"
mkdir -p "$work"
git worktree prune
git worktree add --detach --quiet "$work/base" "$base"
trap 'git -C "$tree" worktree remove --force "$work/base"' EXIT

# Results lie at the same relative path for both, since files name the paths that they were made from.
commands() { # SOURCES RESULTS
    local command="$python -m hil_forceps.cli.main"
    export PYTHONPATH=$1
    mkdir -p "$2"
    cd "$2"
    cp -r "$tree/configs" .
    printf 'time_s,theta_j_rad\n0,0.5\n2,0.3\n4,0.9\n6,0.2\n8,0.6\n' >a.csv
    printf 'time_s,theta_j_rad\n0,0.5\n1,0.9\n3,0.4\n5,0.7\n8,0.1\n' >b.csv
    printf 'time_s,theta_j_rad\n0,0.5\n3,0.1\n4,0.8\n7,0.5\n8,0.4\n' >c.csv
    local run
    for run in a b c; do
        $command run --rig configs/realistic.yaml --interface virtual_forceps --channel bench \
            --option rig=configs/realistic.yaml --trajectory $run.csv --duration 8 --out run-$run >run-$run.txt
    done
    sed 's/^\( *k_N_per_m:\).*/\1 2.0e+4/' configs/realistic.yaml >softer.yaml
    $command diagnose run-a/run.mcap run-b/run.mcap run-c/run.mcap --rig softer.yaml --out diagnosis >diagnosis.txt
    $command import run-a/run.mcap --rig configs/realistic.yaml --out table >import.txt || echo "exit $?" >>import.txt
    $command simulate --like run-b/run.mcap --rig configs/realistic.yaml --out beside >simulate.txt || echo "exit $?" >>simulate.txt
    $command replay run-a/run.mcap --rig configs/realistic.yaml --out again >replay.txt || echo "exit $?" >>replay.txt
    $command decode run-a/bus.log >decoded.txt || echo "exit $?" >>decoded.txt
    $command bench --config configs/paper.yaml --out bench >/dev/null
    $command conformance --interface virtual_forceps --channel bench --option rig=configs/paper.yaml --out certificate >/dev/null ||
        echo "exit $?" >certificate.txt
}

(commands "$work/base" "$work/results-base/results")
(commands "$tree" "$work/results-tree/results")
find "$work"/results-*/ -name timing.json -delete
find "$work/results-tree" -type f | wc -l | sed 's/$/ files compared/'
diff -rq "$work/results-base" "$work/results-tree" && echo "the same bytes as $base"
