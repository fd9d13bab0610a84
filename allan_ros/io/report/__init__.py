# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of one analysis: a verdict, charts one can touch, tables, and how it was done."""

from .page import ReportContext, render_report

__all__ = ['ReportContext', 'render_report']
