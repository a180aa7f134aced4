#!/bin/sh
# ekf.sh PROBLEM.mat ESTIMATES.mat, as "exec:" starts it
exec octave-cli --quiet --path "$(dirname "$0")" --eval "ekf ('$1', '$2')"
