# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of recordings as lines of text, for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from ..core.filters.reductions import horizon_text
from ..results.common_result import CommonResult
from ..results.comparison import Inflation
from .comparison_table import common_table, deviation_ratio_table, inflation_table
from .finding_text import finding_line
from .table import WIDE, terminal_lines


def inflation_lines(inflation: Inflation, columns: int = WIDE) -> Iterator[str]:
    """Yield the lines of text about the noise with motors on, compared with motors off.

    The lines contain N and K, the ratios of the Allan deviations, and the option for `allan
    export`. ``columns`` is the width of the text in characters.
    """
    yield f'N and K for a filter, over {horizon_text(inflation.horizon)}'
    yield from terminal_lines(inflation_table(inflation), columns)
    yield from ('', 'Allan deviation with motors on over motors off, 95 % interval')
    yield from terminal_lines(deviation_ratio_table(inflation), columns)
    yield from ('', f'For `allan export`: --inflate {inflation.option}')


def common_lines(common: CommonResult, units: str = 'deg/h', columns: int = WIDE) -> Iterator[str]:
    """Yield the lines of the table of common noise, and the warnings about the recordings.

    ``units`` is 'deg/h' or 'SI', and ``columns`` is the width of the text in characters.
    """
    yield from terminal_lines(common_table(common, units), columns)
    for label, found in common.findings.items():
        yield from (
            f'{each.severity}: {label}: {finding_line(each)}'
            for each in found
            if each.severity != 'info'
        )
