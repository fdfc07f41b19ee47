#!/bin/sh
# slurm_farm.sh: docker/launch/slurm.sh on a Slurm of one node, made here and ended again.
#
# By hand, not by ctest: needs root and Debian's slurm-wlm and munge. Told by TILERY_BIN where the
# programs are. Renders on the farm and compares the hash with that of a render without it.
set -eu
top=$(cd "$(dirname "$0")/../.." && pwd)
PATH=${TILERY_BIN:-$top/build/release/bin}:$PATH
export PATH
work=$(mktemp -d)
mkdir -p "$work/state" "$work/spool" /run/munge
chmod 755 "$work"
cores=$(nproc)
host=$(hostname -s)
cat >"$work/slurm.conf" <<CONF
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
SlurmctldPort=16817
SlurmdPort=16818
NodeName=$host NodeAddr=127.0.0.1 CPUs=$cores State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES State=UP
CONF
export SLURM_CONF=$work/slurm.conf
[ -s /etc/munge/munge.key ] || mungekey --create
munged --foreground --force >"$work/munged.log" 2>&1 & munged=$!
sleep 1
slurmctld -D -f "$SLURM_CONF" >"$work/ctld.out" 2>&1 & ctld=$!
slurmd -D -f "$SLURM_CONF" -N "$host" >"$work/slurmd.out" 2>&1 & slurmd=$!
trap 'kill $slurmd $ctld $munged 2>/dev/null; wait; rm -rf "$work"' EXIT
for _ in $(seq 60); do sinfo -h -o %T 2>/dev/null | grep -q idle && break; sleep 0.5; done

export TILERY_SLURM_DIR=$work/farm TILERY_PORT=17000 TILERY_HTTP_PORT=18080
job=$(sbatch --parsable --output "$work/job.out" --time 10 "$top/docker/launch/slurm.sh" --threads 1)
for _ in $(seq 120); do [ -s "$work/job.out" ] && break; sleep 0.5; done
cat "$work/job.out"
TILERY_MASTER=http://127.0.0.1:18080 TILERY_TOKEN=$(cat "$work/farm/token")
export TILERY_MASTER TILERY_TOKEN
set -- "$top/scenes/glass_cbox.json" --spp 4 --size 96x96
tilery submit "$@" --wait --quiet -o "$work/farm.exr"
tilery workers
tilery render "$@" --quiet -o "$work/here.exr"
tilery compare "$work/farm.exr" "$work/here.exr" --identical
scancel "$job"
for _ in $(seq 60); do squeue -h -j "$job" 2>/dev/null | grep -q . || break; sleep 0.5; done
grep -q stopping "$work/farm/master.log"
echo "slurm_farm: the same picture, and the farm ended with its job"
