# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What tests of all rooms share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
"""The checkout."""


@pytest.fixture(scope='session')
def repository() -> Path:
    """Return the folder of the checkout."""
    return ROOT


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Return the folder of real recordings, which are not part of the package.

    It is ``$ALLAN_ROS_SHARED/data``, or ``../shared/data`` beside the checkout. Without it the
    test is skipped.
    """
    shared = Path(os.environ.get('ALLAN_ROS_SHARED', ROOT.parent / 'shared'))
    if not (shared / 'data').is_dir():
        pytest.skip('skipped: no shared data')
    return shared / 'data'
