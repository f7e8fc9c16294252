#!/usr/bin/env bash
# Peers and paper_table in one run: bash tests/benches/run.sh MESHES [REFERENCES] [OUT] [-- OPTIONS]
#
# Needs python3 with venv; for CHOLMOD also a C compiler and libsuitesparse-dev with an optimised BLAS
# (libopenblas-dev). OPTIONS go to paper_table, which runs the peers of each body right before it.
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

python=${PEERS_VENV:-$out/venv}/bin/python
if [ ! -x "$python" ]; then
    python3 -m venv "$(dirname "$(dirname "$python")")"
    "$python" -m pip install --quiet --requirement "$here/peers/requirements.txt"
fi

cd "$root"
# Built before anything is timed.
cargo bench --locked --bench paper_table --no-run
cargo bench --locked --bench paper_table -- --meshes "$meshes" --out "$out" \
    --peers "$python" ${references:+--references "$references"} "$@"
