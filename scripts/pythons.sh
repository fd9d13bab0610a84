#!/usr/bin/env bash
# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
# Print version and path of each CPython from 3.10 to 3.14 that runs here: on the PATH, or installed
# by pyenv.
for minor in 10 11 12 13 14; do
    for python in "python3.$minor" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3."$minor".*/bin/python; do
        if "$python" -c 'import ensurepip' 2>/dev/null; then
            echo "3.$minor $python"
            break
        fi
    done
done
