#!/bin/sh
# slurm.sh: a Tilery farm inside one Slurm job: the master on its first node, a worker on every node.
#
#   sbatch --nodes 4 --exclusive --time 02:00:00 docker/launch/slurm.sh [WORKER OPTIONS...]
#
# Prints the farm's URL into the job's output and keeps its token and data in
# ~/.tilery/JOBID (or TILERY_SLURM_DIR). With them, from a login node:
#
#   export TILERY_MASTER=http://NODE:8080 TILERY_TOKEN=$(cat ~/.tilery/JOBID/token)
#   tilery submit scene.json
#
# The farm ends with the Slurm job; its data stays, and the next one that is given the same folder
# goes on where this one was. The programs must be on the PATH of every node.
set -eu
: "${SLURM_JOB_ID:?run me with sbatch}"
dir=${TILERY_SLURM_DIR:-$HOME/.tilery/$SLURM_JOB_ID}
port=${TILERY_PORT:-7000}
http=${TILERY_HTTP_PORT:-8080}
umask 077
mkdir -p "$dir"
[ -s "$dir/token" ] || od -An -N32 -tx1 /dev/urandom | tr -d ' \n' >"$dir/token"
TILERY_TOKEN=$(cat "$dir/token")
export TILERY_TOKEN

tilery-master --listen "0.0.0.0:$port" --http "0.0.0.0:$http" --data "$dir/data" \
    --token-file "$dir/token" 2>"$dir/master.log" &
master=$!
# What ends the Slurm job ends the master too: it stores what is in memory and exits.
trap 'kill "$master" 2>/dev/null; wait "$master"; exit 0' TERM INT
node=$(hostname)
echo "TILERY_MASTER=http://$node:$http TILERY_TOKEN=\$(cat $dir/token)"

# One worker a node, on the cores that Slurm gave it; they find the master again by themselves.
srun --ntasks-per-node=1 --kill-on-bad-exit=0 --overlap \
    tilery-worker --master "$node:$port" --tag "slurm-$SLURM_JOB_ID" "$@" &
wait $!
kill "$master"
wait "$master"
