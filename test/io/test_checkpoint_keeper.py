# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The keeper of a checkpoint without a path, and with a path that another one has locked."""

from __future__ import annotations

import logging
from pathlib import Path

from allan_ros.core.allan.sums import AllanSums
from allan_ros.io.checkpoint import CheckpointKeeper
from allan_ros.io.recorded import Provenance

LOG = logging.getLogger('test')


def test_without_a_path_nothing_is_kept(small_run: tuple[AllanSums, Provenance]) -> None:
    sums, provenance = small_run
    keeper = CheckpointKeeper('', LOG)
    assert keeper.total((sums,), provenance) == ((sums,), provenance)
    assert not keeper.save(((sums,), provenance))
    assert keeper.begin_anew(((sums,), provenance)) == '' and keeper.findings == ()
    keeper.close()


def test_a_locked_path_is_left_alone(
    tmp_path: Path, small_run: tuple[AllanSums, Provenance]
) -> None:
    sums, provenance = small_run
    path = tmp_path / 'folder' / 'sums.json'
    first, second = CheckpointKeeper(str(path), LOG), CheckpointKeeper(str(path), LOG)
    assert [f.id for f in second.findings] == ['checkpoint_in_use']
    total = second.total((sums,), provenance)
    assert not second.save(total) and not path.exists()
    assert first.save(first.total((sums,), provenance)) and path.exists()
    assert first.findings == ()
    for keeper in (first, second):
        keeper.close()
