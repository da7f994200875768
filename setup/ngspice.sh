#!/bin/sh
# Make sure that the shared library of ngspice is there (and, for the tests, the ngspice program).
# Extra package names may be given as arguments: the continuous integration asks for a browser.
set -eu

have_library() {
    [ -n "${NGSPICE_LIBRARY_PATH:-}" ] && return 0
    { ldconfig -p 2>/dev/null || /sbin/ldconfig -p 2>/dev/null; } | grep -q 'libngspice\.so' && return 0
    for folder in /opt/homebrew/lib /usr/local/lib; do
        [ -e "$folder/libngspice.dylib" ] && return 0
    done
    return 1
}

have_library && command -v ngspice >/dev/null && [ $# -eq 0 ] && exit 0

if command -v apt-get >/dev/null; then
    if [ "$(id -u)" -eq 0 ]; then
        sudo=
    elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        sudo=sudo
    else
        echo "cosim needs ngspice's shared library. Please run:  sudo apt-get install ngspice libngspice0 $*" >&2
        exit 1
    fi
    $sudo apt-get update -qq
    DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq ngspice libngspice0 "$@" >/dev/null
elif command -v brew >/dev/null; then
    brew install --quiet ngspice libngspice "$@"
elif command -v dnf >/dev/null; then
    echo "cosim needs ngspice's shared library. Please run:  sudo dnf install ngspice libngspice $*" >&2
    have_library
else
    echo "cosim needs ngspice's shared library (version 39 or newer): install ngspice and libngspice," >&2
    echo "or set NGSPICE_LIBRARY_PATH to the library's file." >&2
    have_library
fi
