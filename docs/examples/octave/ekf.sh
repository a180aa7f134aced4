#!/bin/sh
# Usage: ekf.sh PROBLEM.mat ESTIMATES.mat, the command of an "exec:" estimator
exec octave-cli --quiet --path "$(dirname "$0")" --eval "ekf ('$1', '$2')"
