#!/bin/sh
# Make sure that the shared library of ngspice is there, and try to have the ngspice program too, which only some
# tests and the test benches need: without it they are left out. More programs may be asked for by name: the
# continuous integration asks for chromium.
set -eu

have_library() {
    if [ -n "${NGSPICE_LIBRARY_PATH:-}" ]; then
        [ -e "$NGSPICE_LIBRARY_PATH" ] && return 0
        echo "NGSPICE_LIBRARY_PATH names no file: $NGSPICE_LIBRARY_PATH" >&2
        return 1
    fi
    { ldconfig -p 2>/dev/null || /sbin/ldconfig -p 2>/dev/null; } | grep -q 'libngspice\.so' && return 0
    for folder in /opt/homebrew/lib /usr/local/lib; do
        [ -e "$folder/libngspice.dylib" ] && return 0
    done
    return 1
}

have_program() {
    case $1 in
        chromium) command -v chromium || command -v chromium-browser || command -v google-chrome-stable || command -v google-chrome ;;
        *) command -v "$1" ;;
    esac >/dev/null 2>&1
}

missing=
have_library || missing=libngspice0
for program in ngspice "$@"; do
    have_program "$program" || missing="$missing $program"
done
[ -n "$missing" ] || exit 0

if command -v apt-get >/dev/null; then
    ask="sudo apt-get install$(printf ' %s' $missing)"
    sudo=none
    if [ "$(id -u)" -eq 0 ]; then
        sudo=
    elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        sudo=sudo
    fi
    if [ "$sudo" != none ]; then
        $sudo apt-get update -qq && DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq $missing >/dev/null || true
    fi
elif command -v brew >/dev/null; then
    ask="brew install ngspice libngspice"
    brew install --quiet ngspice libngspice || true
elif command -v dnf >/dev/null; then
    ask="sudo dnf install ngspice libngspice"
else
    ask="install ngspice and libngspice, version 39 or newer"
fi

if ! have_library; then
    echo "cosim needs ngspice's shared library. Please run:  $ask" >&2
    echo "Without root: unpack the package anywhere and set NGSPICE_LIBRARY_PATH to its libngspice.so.0." >&2
    exit 1
fi
for program in ngspice "$@"; do
    have_program "$program" || echo "note: no $program program on this machine: tests that need it are left out ($ask)" >&2
done
