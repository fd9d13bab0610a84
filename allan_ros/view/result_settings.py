# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings for the fit, the comparison and the output of results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module

from ..core.check import MARGIN
from ..core.fit.result import METHODS
from ..core.settings import UNIT_SYSTEMS, CheckedSettings, choose, parameter
from .format import FORMATS


@dataclass(frozen=True)
class ResultSettings(CheckedSettings):
    """Settings for the fit, the comparison and the output of results."""

    method: str = parameter(
        'likelihood',
        'Method of the fit: likelihood (maximum likelihood, with confidence intervals) or paper '
        '(plain least squares, as in Cong et al. 2019).',
        choices=METHODS,
    )
    units: str = parameter(
        'deg/h',
        'Units of the output: deg/h for the units in datasheets, such as deg/h and ug, or SI.',
        choices=UNIT_SYSTEMS,
    )
    export: tuple[str, ...] = parameter(
        (),
        'Further configuration files: kalibr, openvins, px4 ... (`allan export --list` lists all, '
        '`allan export` has more options).',
    )
    sensor: str = parameter(
        '',
        'Datasheet to compare with: a name that `allan sensors` lists, or the path of a .yaml '
        'file.',
    )
    baseline: str = parameter(
        '', 'Earlier run of this IMU to compare with: its results.json, or its folder.'
    )
    noise: str = parameter(
        '',
        'Earlier run of this IMU at rest, whose noise predicts the errors in motion: its '
        'results.json, or its folder. By default, the noise in the rests of the recording is used.',
    )
    plots: tuple[str, ...] = parameter(
        (), 'Also draw the Allan deviation of each sensor as a figure: png, svg, pdf.'
    )
    margin: float = parameter(
        MARGIN,
        'Margin of the limits: a coefficient exceeds the datasheet or the earlier run if its '
        'complete 95 % interval lies above the limit by more than this fraction.',
        low=0.0,
        high=1.0,
        percent=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_plots(self.plots)

    @property
    def stated_margin(self) -> float | None:
        """The margin if it is not the default; None if it is, so that results keep their margin."""
        return None if self.margin == MARGIN else self.margin


def check_plots(formats: Sequence[str]) -> None:
    """Raise AllanError for an unknown format of figures, or if matplotlib is needed but missing."""
    for form in formats:
        choose(FORMATS, plots=form)
    if formats:
        import_module('.plots', __package__)
