#!/usr/bin/env bash
# Install the wheel in SOURCE/dist into a new environment, at the locked versions. Dockerfile, packaging/sweep.def and
# jobs/wheel.sh run this, so that what goes into an image is tested where images cannot be built.
#   packaging/install.sh SOURCE ENVIRONMENT [EXTRAS], such as packaging/install.sh . /opt/sweep gpu,cluster
# SOURCE holds dist/insect_sweep-*.whl, requirements.lock and constraints.txt. PYTHON names another interpreter than python3.
set -euo pipefail
source=$1 environment=$2 extras=${3:-}
wheels=("$source"/dist/insect_sweep-*.whl)
if [ ${#wheels[@]} != 1 ] || [ ! -f "${wheels[0]}" ]; then
  echo "install.sh: dist must hold one wheel, which 'make wheel' builds; found: ${wheels[*]}" >&2
  exit 2
fi

"${PYTHON:-python3}" -m venv "$environment"
pip() { "$environment/bin/python" -m pip --no-cache-dir --disable-pip-version-check "$@"; }
pip install -q --require-hashes -r "$source/requirements.lock"
pip install -q -c "$source/constraints.txt" "${wheels[0]}${extras:+[$extras]}"
pip check
"$environment/bin/sweep" --version
