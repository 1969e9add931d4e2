# shellcheck shell=bash
# Sets up $python with OpenCV, $parfocal and a driver. run and bench source it in the root of the project.
# PARFOCAL=path selects another build of the program.
. tools/vulkan.sh

venv=target/peers
requirements=tools/peers/requirements.txt

fail() {
  echo "$0: $*" >&2
  exit 1
}

if ! cmp -s "$requirements" "$venv/requirements.txt"; then
  command -v python3 >/dev/null || fail 'Python is missing: install python3 (3.11 or later) and python3-venv'
  python3 -m venv --clear "$venv" || fail 'no virtual environment: install python3-venv (apt-get install python3-venv)'
  "$venv/bin/pip" install --quiet --disable-pip-version-check --requirement "$requirements" ||
    fail "pip could not install $requirements; it needs Python 3.11 or later and PyPI"
  cp "$requirements" "$venv/requirements.txt" # last, so that an interrupted installation is repeated
fi
# shellcheck disable=SC2034 # the scripts that source this file use it
python=$venv/bin/python

parfocal=${PARFOCAL:-${CARGO_TARGET_DIR:-target}/release/parfocal}
[[ -x $parfocal ]] || cargo build --release --locked
use_driver || true # the program reports what is missing
export PYTHONDONTWRITEBYTECODE=1 # no bytecode files beside the sources
