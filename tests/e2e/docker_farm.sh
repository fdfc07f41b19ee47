#!/bin/sh
# docker_farm.sh: builds the image, starts a master and three worker containers by Compose, renders
# the report's scene through them and compares its hash with a local render.
#
# Skips (77) only where no engine answers. TILERY_BIN names the local programs.
set -eu
top=$(cd "$(dirname "$0")/../.." && pwd)
cd "$top"
docker info >/dev/null 2>&1 || {
    echo "docker_farm: no Docker engine answers"
    exit 77
}

scratch=$(mktemp -d)
project=tilerytest$$
compose() {
    docker-compose -p "$project" -f docker/compose.yaml "$@"
}
finish() {
    compose logs --no-color >"$scratch/compose.log" 2>&1 || true
    [ "${passed-}" = 1 ] || tail -n 40 "$scratch/compose.log"
    compose down -v -t 2 >/dev/null 2>&1 || true
    rm -rf "$scratch"
}
TILERY_TOKEN=$(od -An -N32 -tx1 /dev/urandom | tr -d ' \n')
TILERY_IMAGE=tilery:$project
TILERY_HTTP_PORT=$(python3 -c 'import socket
s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
export TILERY_TOKEN TILERY_IMAGE TILERY_HTTP_PORT
trap finish EXIT

docker/make-base.sh
docker build -q -f docker/Dockerfile -t "$TILERY_IMAGE" . >/dev/null
user=$(docker run --rm "$TILERY_IMAGE" id -u)
[ "$user" != 0 ] || {
    echo "docker_farm: the image runs as root"
    exit 1
}
compose up -d --scale worker=3 >/dev/null 2>&1

TILERY_MASTER=http://127.0.0.1:$TILERY_HTTP_PORT
export TILERY_MASTER
tries=0
until [ "$("$TILERY_BIN/tilery" workers --json 2>/dev/null | grep -o '"id"' | wc -l)" -ge 3 ]; do
    tries=$((tries + 1))
    [ $tries -le 120 ] || {
        echo "docker_farm: three workers did not register within 60 s"
        exit 1
    }
    sleep 0.5
done

scene=scenes/cbox_no_light_refract.json
job=$("$TILERY_BIN/tilery" submit "$scene")
"$TILERY_BIN/tilery" watch "$job" --progress lines 2>"$scratch/watch.log"
"$TILERY_BIN/tilery" get "$job" -o "$scratch/docker.exr"
"$TILERY_BIN/tilery" render "$scene" -o "$scratch/local.exr" --quiet --report "$scratch/local.json"

hash_of() {
    python3 -c 'import json, sys; print(json.load(sys.stdin)["image_sha256"])'
}
farm_hash=$("$TILERY_BIN/tilery" status "$job" --json | hash_of)
local_hash=$(hash_of <"$scratch/local.json")
workers=$("$TILERY_BIN/tilery" status "$job" --json |
    python3 -c 'import json, sys; print(json.load(sys.stdin)["workers"])')
echo "docker_farm: $workers worker containers $farm_hash, local $local_hash"
"$TILERY_BIN/tilery" compare "$scratch/docker.exr" "$scratch/local.exr" --identical >/dev/null
[ "$farm_hash" = "$local_hash" ] && [ "$workers" = 3 ]
passed=1
docker image rm -f "$TILERY_IMAGE" >/dev/null 2>&1 || true
