#!/usr/bin/env bash
# Peers and paper_table in one run: bash tests/benches/run.sh MESHES [REFERENCES] [OUT] [-- OPTIONS]
#
# Needs python3 with venv; for CHOLMOD also a C compiler and libsuitesparse-dev with an optimised BLAS
# (libopenblas-dev). OPTIONS go to paper_table (--bodies and --repeat to the peers as well).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)

paths=()
while [ $# -gt 0 ] && [ "$1" != -- ]; do
    paths+=("$(realpath -m "$1")")
    shift
done
[ $# -gt 0 ] && shift
[ ${#paths[@]} -ge 1 ] || { sed -n '2p' "$0" >&2; exit 2; }
meshes=${paths[0]}
references=${paths[1]:-}
out=${paths[2]:-${CARGO_TARGET_DIR:-$root/target}/paper_table}
mkdir -p "$out"

shared=()
previous=
for option in "$@"; do
    case $previous in --bodies | --repeat) shared+=("$previous" "$option") ;; esac
    previous=$option
done

python=${PEERS_VENV:-$out/venv}/bin/python
if [ ! -x "$python" ]; then
    python3 -m venv "$(dirname "$(dirname "$python")")"
    "$python" -m pip install --quiet --requirement "$here/peers/requirements.txt"
fi

cd "$root"
# Built before anything is timed.
cargo bench --locked --bench paper_table --no-run
"$python" "$here/peers/peers.py" --meshes "$meshes" --out "$out/peers.json" "${shared[@]}"
cargo bench --locked --bench paper_table -- --meshes "$meshes" --out "$out" \
    --peers "$out/peers.json" ${references:+--references "$references"} "$@"
