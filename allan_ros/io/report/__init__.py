# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The HTML report of an analysis: verdict, interactive charts, tables and method."""

from .page import ReportContext, render_report

__all__ = ['ReportContext', 'render_report']
