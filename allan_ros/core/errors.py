# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The one base error of the package: its message says what is wrong, where, and what to do."""


class AllanError(Exception):
    """Something a user can mend.

    The message is one line that carries the numbers and the next step. It is caught once, at the
    shell (command line or node), and shown without a traceback.
    """
