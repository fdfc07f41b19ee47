#!/bin/sh
# canary.sh PROGRAM: a simulation with a bug in it must fail within its seeds; else the simulation is
# blind. Exit 0: it failed.
out=$("$1" --count 4000 2>&1)
status=$?
echo "$out" | tail -3
if [ $status -eq 0 ]; then
    echo "canary: $(basename "$1") lives: its bug was not found" >&2
    exit 1
fi
