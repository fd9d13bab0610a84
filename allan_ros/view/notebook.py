# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results as HTML for a Jupyter notebook."""

from __future__ import annotations

from html import escape

from ..core.imu import AXES, SENSORS
from ..core.settings import UNIT_SYSTEMS
from ..results.results import Results
from .coefficient_table import coefficient_table
from .table import html_table
from .verdict_text import headline, verdict_of

NOTEBOOK_STYLE = (
    '.allan_ros small { display: block; opacity: .7; } .allan_ros table { margin: .5em 0; }'
)
"""Style sheet that places the intervals below the values."""


def notebook_html(results: Results) -> str:
    """Return the verdict and the coefficients of each sensor as HTML, in datasheet units."""
    units = UNIT_SYSTEMS[0]
    parts = [f'<p>{escape(headline(results))}</p>']
    parts.append(f'<p><b>{escape(verdict_of(results, units).summary)}</b></p>')
    for rows in SENSORS.values():
        coefficients = {axis: results.noise[axis] for axis in AXES[rows] if axis in results.axes}
        if coefficients:
            table = coefficient_table(coefficients, units, prefixes=True)
            parts.append(html_table('coefficients', lambda _, table=table: table))  # type: ignore[misc]
    return f'<div class="allan_ros"><style>{NOTEBOOK_STYLE}</style>{"".join(parts)}</div>'
