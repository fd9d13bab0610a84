# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise parameters that a target takes, and the entries of its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...core.findings import Finding

VIO_HORIZON_S = 30.0
"""A camera or lidar corrects the integration; drift counts over 1 to 30 s."""

INS_HORIZON_S = 100.0
"""GNSS corrects the integration and may be out for a while; drift counts over 1 to 100 s."""

SIMULATOR_HORIZON_S = 1000.0
"""A simulated sensor should drift like the real one over 1 to 1000 s."""

Value = Any
"""A number, a string, a list or a mapping of these: what a file can hold under a key."""


@dataclass(frozen=True)
class Entry:
    """One key of a file.

    Attributes
    ----------
    path : tuple of str
        The key, after the keys of the mappings that contain it.
    value : Value
    words : str
        Origin of the number: unit, formula, axis, interval. '' for what is not measured.
    is_limit : bool
        Whether the number comes from a 95 % upper limit.
    keep : bool
        Whether to leave the value in the user's own file alone, because it is not measured.
    findings : tuple of Finding
        What the user should know about it.
    """

    path: tuple[str, ...]
    value: Value
    words: str = ''
    is_limit: bool = False
    keep: bool = False
    findings: tuple[Finding, ...] = ()

    @property
    def key(self) -> str:
        """The last key of the path."""
        return self.path[-1]


@dataclass(frozen=True)
class Convention:
    """How a target reads its numbers.

    Attributes
    ----------
    text : str
        Convention of the numbers, and the source file of the target that shows it.
    three : bool
        Whether the file takes three numbers per sensor.
    rate_hz : float or None
        The filter's own rate; None where it steps with the samples.
    horizon_s : float
        Default upper end of the horizons of the reduction, in s.
    walk : bool
        Whether the target has a random walk of the bias, and so takes N from the same reduction.
    bound : bool
        Whether the reduction bounds the error growth, as a filter needs it; a simulator gets the
        closest one.
    exact : bool
        Whether `ExportOptions.exact` applies.
    """

    text: str
    three: bool = False
    rate_hz: float | None = None
    horizon_s: float = VIO_HORIZON_S
    walk: bool = True
    bound: bool = True
    exact: bool = False
