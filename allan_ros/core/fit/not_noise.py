# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a recording shows the noise of the sensor, or rather motion and vibration.

An axis is disturbed if the noise of the sensor is not what its model mainly describes. There are
three marks; none of them occurs with a sensor at rest beside a fan, which adds few narrow lines.

1. Several oscillations that are broad or slow, or more than `MOST_LINES` processes of any kind,
   have together more variance than the white noise of a sample.
2. The white noise is not resolved, or known much less precisely than white noise of this bandwidth
   and length would be: something else lies above it at all frequencies.
3. The model does not fit in more than a third of the octaves of frequencies.

A recording is not a noise recording if at least half of its axes are disturbed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..estimate import Z_95
from ..findings import Finding, finding
from .result import AxisFit, NoiseModel

MOST_LINES = 3
"""Largest number of processes with a shape that a fan or another machine beside a sensor causes."""

SLOW_HZ = 3.0
"""Frequency in Hz below which an oscillation is motion: machines and buildings vibrate faster."""

LARGEST_WIDTH, LARGEST_EXCESS = 0.1, 5.0
"""Half the width of the interval of N, relative to N, above which the white noise is obscured, and
the least ratio of this width to that of pure white noise. Clean recordings have ratios of 1 to 3,
heavy tails 8. Gauss-Markov noise of 2 samples has ratios up to 30, but widths below 0.1 on nearly
all axes. Vehicles have ratios of 6 to 20 and widths up to 0.4."""

LACK_OF_FIT_SHARE = 1.0 / 3.0
"""Share of the octaves without fit above which the model does not describe an axis."""

DISTURBED_SHARE = 0.5
"""Share of disturbed axes from which on a recording is not a noise recording."""

LEAST_S = 20.0
"""Shortest recording in s that is judged."""


def not_noise_findings(models: Sequence[NoiseModel], seconds: float) -> list[Finding]:
    """Return the finding that the recording is not a noise recording, or an empty list.

    Parameters
    ----------
    models : sequence of NoiseModel
        The fits of all axes of an IMU: one, or one for each sensor if their rates differ.
    seconds : float
        Time at rest in s.
    """
    if seconds < LEAST_S:
        return []
    fits = {name: (fit, m.tau0) for m in models for name, fit in m.axes.items()}
    disturbed = [name for name, (fit, tau0) in fits.items() if is_disturbed(fit, tau0, seconds)]
    if not disturbed or len(disturbed) < DISTURBED_SHARE * len(fits):
        return []
    return [finding('not_noise', tuple(disturbed))]


def is_disturbed(fit: AxisFit, tau0: float, seconds: float) -> bool:
    """Return whether motion or vibration hides the noise of an axis.

    Parameters
    ----------
    fit : AxisFit
    tau0 : float
        Sample period in s.
    seconds : float
        Time at rest in s.
    """
    n = fit.noise['N']
    white = ((n.value if n.resolved else n.upper95) or 0.0) ** 2 / tau0
    if not white:
        return False
    shares = [
        (p.process, p.value**2 / (2.0 if p.process.is_line else 1.0) / white)
        for p in fit.model.shaped.parts
        if not p.process.is_drift
    ]
    motion = [s for p, s in shares if not p.is_line or p.numbers['frequency'] < SLOW_HZ]
    if len(motion) > 1 and sum(motion) > 1.0:
        return True
    if len(shares) > MOST_LINES and sum(s for _, s in shares) > 1.0:
        return True
    return _is_obscured(fit, tau0, seconds) or _is_misfit(fit, tau0, seconds)


def _is_obscured(fit: AxisFit, tau0: float, seconds: float) -> bool:
    """Return whether N is known much less precisely than white noise of this length would be.

    2 B T samples of white noise of the bandwidth B determine N to a relative standard deviation of
    1 / sqrt(4 B T). N may be unknown beside quantization noise (Q).
    """
    n = fit.noise['N']
    if not n.resolved:
        return not fit.noise['Q'].resolved
    if not n.value or n.recording_ci95 is None:
        return False
    bandwidth = min(0.5 / tau0, 4.0 / (fit.m_min * tau0)) if fit.filtered else 0.5 / tau0
    low, high = n.recording_ci95
    width = (high - low) / (2.0 * n.value)
    return width > max(LARGEST_WIDTH, LARGEST_EXCESS * Z_95 / math.sqrt(4.0 * bandwidth * seconds))


def _is_misfit(fit: AxisFit, tau0: float, seconds: float) -> bool:
    octaves = math.log2(max(seconds / (2.0 * tau0), 2.0))
    missed = sum(math.log2(each.high / each.low) for each in fit.lack_of_fit if each.low > 0.0)
    return missed > LACK_OF_FIT_SHARE * octaves
