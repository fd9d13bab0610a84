# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of the documentation from simulated IMUs.

usage: pictures.py FOLDER

The IMU is simulated as with `allan simulate --preset paper`, in some figures with a fault.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import allan_ros as ar
from allan_ros.core.imu import UNITS
from allan_ros.core.noise import Model
from allan_ros.view.format import TERM_STYLES
from allan_ros.view.plots import LIMIT_ALPHA

RATE = 100.0
"""Sample rate of the simulated IMUs in Hz."""

HOUR = 3600.0

DEG_H = 1.0 / UNITS['deg/h'].factor
UG = 1.0 / UNITS['ug'].factor
"""Factors that convert SI to deg/h and to ug."""

DPI = 100
FONT = {'font.size': 9.0, 'axes.grid': False}
GRAY = '0.6'
ON_WHITE = {'facecolor': 'white', 'edgecolor': 'none', 'pad': 1.0}
"""Style of the background of text, which hides the lines behind the text."""

ALL_FIVE = Model.of(Q=2.4e-6, N=7e-6, B=7e-6, K=2.4e-7, R=2.4e-9)
"""Noise of a fictitious gyro, in SI, whose Allan curve shows all five terms."""


@dataclass(frozen=True)
class Shape:
    """A figure of noise that the five terms do not describe."""

    name: str
    axis: str
    faults: dict[str, float]
    hours: float
    says: str


SHAPES = (
    Shape('filtered', 'gyro_z', {'low_pass': 15.0}, 2.0, 'low-pass filter of 15 Hz'),
    Shape(
        'line',
        'gyro_z',
        {'vibration_gyro': 6e-5, 'vibration_frequency': 0.05},
        2.0,
        'vibration at 0.05 Hz',
    ),
    Shape('warm-up', 'gyro_z', {'warmup_gyro': 3e-3, 'warmup_time': 600.0}, 2.0, 'warming up'),
    Shape(
        'correlated',
        'gyro_z',
        {'gauss_markov_gyro': 8e-5, 'gauss_markov_time': 20.0},
        2.0,
        'bias that returns within 20 s',
    ),
    Shape('rounded', 'gyro_z', {'lsb_gyro': 1.75e-3}, 2.0, 'values rounded to 0.1 deg/s'),
)


def analyzed(hours: float, seed: int = 0, **faults: object) -> ar.Results:
    """Return the results of a simulated IMU with the given faults."""
    recording = ar.simulate(hours, RATE, seed=seed, **faults)
    return ar.analyze(recording, rate=RATE, motion_gate=False, skip=0)


def draw_measured(panel: Axes, curve: ar.AxisCurve, factor: float, **style: object) -> None:
    """Draw the points of an Allan curve, and the band of their 68 % limits."""
    panel.fill_between(curve.tau, factor * curve.ci_low, factor * curve.ci_high, color='0.85', lw=0)
    panel.plot(
        curve.tau,
        factor * curve.adev,
        **{'marker': 'o', 'ms': 3.5, 'ls': '', 'mfc': 'white', 'mec': '0.1', 'mew': 0.9, **style},
    )


def draw_parts(panel: Axes, result: ar.AxisResult, factor: float, lowest: float) -> None:
    """Draw the model, its terms, and the area up to the limits of unresolved terms."""
    curve = result.curve
    assert curve is not None
    for name, part in result.part_adev(curve.m).items():
        color, dashes = TERM_STYLES.get(name, (GRAY, '-'))
        shown = np.where(factor * part > lowest, factor * part, np.nan)
        panel.plot(curve.tau, shown, color=color, ls=dashes, lw=1.5, label=name)
    model, upper = (factor * line for line in result.model_line())
    panel.plot(curve.tau, model, color='black', lw=1.0, label='fit', zorder=1.9)
    panel.fill_between(curve.tau, model, upper, color='black', alpha=LIMIT_ALPHA, lw=0)


def new_figure(width: float, height: float, columns: int = 1) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure of a given size in inches, and its panels with logarithmic axes."""
    figure = Figure(figsize=(width, height), layout='constrained')
    panels = figure.subplots(1, columns, squeeze=False)[0]
    for panel in panels:
        panel.set(xscale='log', yscale='log', xlabel='averaging time τ [s]')
        panel.grid(which='major', color='0.9', lw=0.6)
    return figure, panels


def five_slopes() -> Figure:
    """Draw the Allan curve of a gyro with all five terms, and label the terms with their slopes."""
    figure, (panel,) = new_figure(6.4, 4.2)
    tau = np.geomspace(0.01, 1e5, 400)
    avar = DEG_H**2 * np.stack([*ALL_FIVE.contributions(tau, 1.0 / RATE).values()], axis=-1)
    panel.plot(tau, np.sqrt(avar.sum(axis=1)), color='black', lw=2.2)
    names = {
        'Q': ('Q  quantization\nslope −1', 0.03, 50.0),
        'N': ('N  angle random\nwalk, slope −½', 0.012, 1.25),
        'B': ('B  bias instability\nflat, at 0.664 B', 0.013, 0.5),
        'K': ('K  rate random\nwalk, slope +½', 4.2e3, 0.4),
        'R': ('R  rate ramp\nslope +1', 1.5e3, 14.0),
    }
    for term, part in zip('QNBKR', np.sqrt(avar).T):
        color, dashes = TERM_STYLES[term]
        panel.plot(tau, part, color=color, ls=dashes, lw=1.5)
        text, x, y = names[term]
        panel.text(x, y, text, color=color, bbox=ON_WHITE)
    panel.set(ylim=(0.25, 120.0), ylabel='Allan deviation [deg/h]', xlim=(tau[0], tau[-1]))
    return figure


def wrong_shape(shape: Shape) -> Figure:
    """Draw the Allan curves of an IMU with a fault and of the same IMU without the fault."""
    bad, good = analyzed(shape.hours, **shape.faults), analyzed(shape.hours)
    figure, (panel,) = new_figure(5.2, 3.2)
    clean = good.axes[shape.axis].curve
    assert clean is not None
    panel.plot(clean.tau, DEG_H * clean.adev, color='#56B4E9', lw=1.2, label='without it')
    draw_measured(panel, bad[shape.axis].curve, DEG_H)
    draw_parts(panel, bad.axes[shape.axis], DEG_H, 2.0)
    panel.set(ylabel='Allan deviation [deg/h]', ylim=(2.0, None))
    panel.legend(frameon=False, fontsize=8)
    panel.set_title(shape.says, fontsize=9)
    return figure


def held_samples() -> Figure:
    """Draw the Allan curve of an accelerometer of 62.5 Hz, with and without repeated samples."""
    faults = {'accel_rate': 62.5}
    figure, (panel,) = new_figure(5.2, 3.2)
    repeated = ar.adev(ar.simulate(0.5, RATE, **faults).samples[:, 5], RATE)
    fresh = analyzed(0.5, **faults)['accel_z'].curve
    draw_measured(panel, repeated, UG, label='every message counted')
    draw_measured(
        panel, fresh, UG, label='fresh samples only', mfc='#0072B2', mec='#0072B2', ms=2.5
    )
    panel.set(ylabel='Allan deviation [ug]')
    panel.legend(frameon=False, fontsize=8)
    panel.set_title('accelerometer of 62.5 Hz in messages of 100 Hz', fontsize=9)
    return figure


def more_time() -> Figure:
    """Draw the Allan curves of one gyro for recordings of 10 min, 1 h and 8 h."""
    figure, panels = new_figure(9.0, 3.1, 3)
    for panel, (hours, name) in zip(panels, ((1 / 6, '10 min'), (1.0, '1 h'), (8.0, '8 h'))):
        result = analyzed(hours, seed=1).axes['gyro_z']
        draw_measured(panel, result.curve, DEG_H)
        draw_parts(panel, result, DEG_H, 2.0)
        seen = ', '.join(t for t in 'QNBKR' if result.fit.noise[t].status == 'estimated')
        panel.set_title(f'{name}: shows {seen}', fontsize=9)
        panel.set(xlim=(0.008, 2e4), ylim=(2.0, 300.0))
    panels[0].set_ylabel('Allan deviation [deg/h]')
    panels[-1].legend(frameon=False, fontsize=8)
    return figure


def main() -> int:
    """Write all figures to the folder that is given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with rc_context(FONT):
        figures = {
            'five-slopes': five_slopes(),
            'more-time': more_time(),
            'held': held_samples(),
            **{shape.name: wrong_shape(shape) for shape in SHAPES},
        }
        for name, figure in figures.items():
            path = folder / f'{name}.png'
            figure.savefig(path, dpi=DPI, metadata={'Software': 'allan_ros'})
            print(f'{path}: {path.stat().st_size / 1000:.0f} kB')
    return 0


if __name__ == '__main__':
    sys.exit(main())
