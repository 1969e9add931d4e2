# shellcheck shell=bash
# What run and bench need, sourced by both from the project's root: $python with OpenCV, $parfocal, a driver.
# PARFOCAL=path names another build of the program.
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
  cp "$requirements" "$venv/requirements.txt" # last: an interrupted installation is done again
fi
# shellcheck disable=SC2034 # for those that source this
python=$venv/bin/python

parfocal=${PARFOCAL:-${CARGO_TARGET_DIR:-target}/release/parfocal}
[[ -x $parfocal ]] || cargo build --release --locked
use_driver || true # the program says what is missing
export PYTHONDONTWRITEBYTECODE=1 # nothing beside the sources
