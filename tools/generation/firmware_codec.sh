#!/bin/sh
# Writes the C codec of the reference firmware anew from the DBC. Usage: tools/generation/firmware_codec.sh [DIRECTORY]
set -eu
cd "$(dirname "$0")/../.."
python=${PYTHON:-python3}
"$python" -m cantools generate_c_source --no-floating-point-numbers --database-name motor_driver \
    --output-directory "${1:-firmware_protocol/c/generated}" firmware_protocol/motor_driver.dbc
