# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of recordings that show motion or vibration instead of the noise of the sensor.

A recording is not a noise recording if at least half of its axes are disturbed.

Conditions for a disturbed axis
-------------------------------
An axis is disturbed if one of these conditions holds. None of the conditions holds for a sensor at
rest beside a fan, which adds only a few sinusoids.

1. Several broad or slow oscillations, or more than `MOST_LINES` oscillations of any kind, together
   have more variance than the white noise of a sample.
2. The white noise is not resolved, or is known much less precisely than pure white noise in a
   recording of this length would be. Other noise is then larger at all frequencies.
3. The model does not fit in more than a third of the octaves of frequencies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..estimate import Z_95
from ..findings import Finding, finding
from .result import AxisFit, NoiseModel

MOST_LINES = 3
"""Largest number of oscillations in the model of an axis that a machine such as a fan causes beside
the sensor."""

SLOW_HZ = 3.0
"""Frequency in Hz below which an oscillation counts as motion. Machines and buildings vibrate
faster."""

LARGEST_WIDTH, LARGEST_EXCESS = 0.1, 5.0
"""The white noise is obscured if half of the width of the interval of N, relative to N, exceeds
both `LARGEST_WIDTH` and `LARGEST_EXCESS` times the half width for pure white noise. The ratio of
the half widths is 1 to 3 in clean recordings, 8 with heavy tails, and 6 to 20 in vehicles, with
half widths up to 0.4. Gauss-Markov noise with a correlation time of 2 samples causes ratios up to
30, but half widths below 0.1 on nearly all axes."""

LACK_OF_FIT_SHARE = 1.0 / 3.0
"""Largest share of octaves with a lack of fit for which the model describes an axis."""

DISTURBED_SHARE = 0.5
"""Least share of disturbed axes for which a recording is not a noise recording."""

LEAST_S = 20.0
"""Shortest recording in s that is judged."""


def not_noise_findings(models: Sequence[NoiseModel], seconds: float) -> list[Finding]:
    """Return one finding if the recording is not a noise recording, else an empty list.

    Parameters
    ----------
    models : sequence of NoiseModel
        Fits of one IMU: one fit for all axes, or one for each sensor if the sample rates differ.
    seconds : float
        Time at rest in s.
    """
    if seconds < LEAST_S:
        return []
    fits = {name: (fit, m.tau0) for m in models for name, fit in m.axes.items()}
    disturbed_axes = [
        name for name, (fit, tau0) in fits.items() if is_disturbed(fit, tau0, seconds)
    ]
    if not disturbed_axes or len(disturbed_axes) < DISTURBED_SHARE * len(fits):
        return []
    return [finding('not_noise', tuple(disturbed_axes))]


def is_disturbed(fit: AxisFit, tau0: float, seconds: float) -> bool:
    """Return whether motion or vibration hides the noise of an axis.

    Parameters
    ----------
    fit : AxisFit
        Fit of the axis.
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
    motion_shares = [s for p, s in shares if not p.is_line or p.numbers['frequency'] < SLOW_HZ]
    if len(motion_shares) > 1 and sum(motion_shares) > 1.0:
        return True
    if len(shares) > MOST_LINES and sum(s for _, s in shares) > 1.0:
        return True
    return _is_obscured(fit, tau0, seconds) or _has_lack_of_fit(fit, tau0, seconds)


def _is_obscured(fit: AxisFit, tau0: float, seconds: float) -> bool:
    """Return whether N is known much less precisely than it would be if all noise was white.

    Pure white noise with the bandwidth W determines N in the time T with a relative standard error
    of 1 / sqrt(4 W T). If quantization noise (Q) is resolved, N need not be resolved.
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


def _has_lack_of_fit(fit: AxisFit, tau0: float, seconds: float) -> bool:
    octaves = math.log2(max(seconds / (2.0 * tau0), 2.0))
    octaves_with_lack = sum(
        math.log2(each.high / each.low) for each in fit.lack_of_fit if each.low > 0.0
    )
    return octaves_with_lack > LACK_OF_FIT_SHARE * octaves
