# scripts/packages.sh: the Debian 12 packages that each purpose needs. Sourced.
#
# install_packages LIST... installs what is missing, as root or through sudo.

packages_build="gcc libc6-dev cmake ninja-build pkg-config ca-certificates git
    libuv1-dev libopenexr-dev libzstd-dev libgnutls28-dev libmicrohttpd-dev
    libsqlite3-dev libcurl4-gnutls-dev libpng-dev libturbojpeg0-dev libsleef-dev libassimp-dev
    nanopb libnanopb-dev protobuf-compiler python3-protobuf uthash-dev"
packages_test="libcmocka-dev clang-14 libclang-rt-14-dev clang-format-14 libembree-dev
    python3 python3-pytest python3-numpy python3-requests python3-jsonschema python3-venv
    binutils procps curl patch chromium fonts-dejavu-core"
# Mitsuba's fast variant (tests/mitsuba/run); its wheel aborts with older ones.
packages_peer="libllvm19"
# Cycles (tests/cycles/run).
packages_cycles="blender python3-numpy"
packages_docker="docker.io docker-compose debootstrap"

install_packages() {
    missing=
    for package in "$@"; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q '^install ok installed$' ||
            missing="$missing $package"
    done
    [ -z "$missing" ] && return 0
    if [ "$(id -u)" = 0 ]; then
        as_root=
    elif command -v sudo >/dev/null 2>&1; then
        as_root=sudo
    else
        echo "these packages are missing and only root can install them:$missing" >&2
        echo "  run as root: apt-get install --no-install-recommends$missing" >&2
        return 5
    fi
    echo "installing:$missing" >&2
    # shellcheck disable=SC2086 # a list of words
    $as_root apt-get update -q >/dev/null &&
        $as_root env DEBIAN_FRONTEND=noninteractive \
            apt-get install -q -y --no-install-recommends $missing >/dev/null
}
