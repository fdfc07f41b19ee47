#!/bin/sh
# docker/make-base.sh: makes the image debian:bookworm-slim where none can be pulled.
#
# usage: docker/make-base.sh [IMAGE]      (default debian:bookworm-slim)
#
# Does nothing when the image is there already. Needs root and debootstrap; takes half a minute.
set -eu
image=${1:-debian:bookworm-slim}

if docker image inspect "$image" >/dev/null 2>&1; then
    echo "make-base: $image is there"
    exit 0
fi
if ! command -v debootstrap >/dev/null 2>&1; then
    echo "make-base: debootstrap is missing; apt-get install debootstrap" >&2
    exit 5
fi
if [ "$(id -u)" != 0 ]; then
    echo "make-base: debootstrap needs root" >&2
    exit 5
fi

root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
debootstrap --variant=minbase bookworm "$root" >"$root.log" 2>&1 || {
    tail -n 20 "$root.log" >&2
    exit 5
}
rm -f "$root.log"
rm -rf "$root"/var/cache/apt/archives/*.deb "$root"/var/lib/apt/lists/*
tar -C "$root" -c . | docker import - "$image" >/dev/null
echo "make-base: made $image"
