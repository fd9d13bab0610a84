# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Aligned arrays and memory that is used again."""

import threading

import numpy as np
import pytest

from allan_ros.core.memory import KNOWN, LINE, WorkMemory, aligned


@pytest.mark.parametrize('kind', ['f4', 'f8', 'u1'])
@pytest.mark.parametrize('shape', [(0,), (1,), (7, 3), (2, 3, 1001)])
def test_an_aligned_array_begins_with_a_line(kind, shape):
    array = aligned(shape, kind)
    assert array.shape == shape and array.dtype == kind and array.flags['C_CONTIGUOUS']
    assert array.__array_interface__['data'][0] % LINE == 0 or not array.size


def test_work_arrays_are_apart_and_use_the_same_memory():
    work = WorkMemory()
    first, second = work.arrays('f8', (3, 5), (4,))
    first[:], second[:] = 1.0, 2.0
    assert (first == 1.0).all() and (second == 2.0).all()
    (again,) = work.arrays('f4', (3, 5))
    assert np.shares_memory(first, again)
    assert work.arrays('f8', (3, 5), (4,))[0] is first


def test_work_memory_grows_and_forgets():
    work = WorkMemory()
    for n in range(1, 3 * KNOWN):
        large, small = work.arrays('f8', (100 * n,), (n,))
        large[:], small[:] = 0.0, 1.0
        assert not large.any() and small.all()


def test_threads_have_their_own_memory():
    work, found = WorkMemory(), []
    thread = threading.Thread(target=lambda: found.extend(work.arrays('f8', (9,))))
    thread.start()
    thread.join()
    assert not np.shares_memory(found[0], work.arrays('f8', (9,))[0])
