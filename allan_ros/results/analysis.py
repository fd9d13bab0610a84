# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit the Allan sums of recordings, and return `Results`.

Linear algebra is limited to one thread during a fit. The matrices have about a hundred rows. More
threads do not make the fit faster, and their busy-waiting multiplies the CPU time. The limit is set
only for OpenBLAS on Linux; the Linux wheels of numpy and scipy contain this library.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.allan.at_rest import at_rest, rounding_step, turn_on_bias
from ..core.allan.curve import AllanCurve, allan_curve
from ..core.allan.sums import AllanSums
from ..core.errors import AllanError
from ..core.findings import Finding
from ..core.fit.fit_findings import not_noise_findings, with_deviations
from ..core.fit.result import NoiseModel, dominant_regions
from ..core.fit.stationary import fit_stationary
from ..core.imu import AXES
from ..core.settings import AUTO
from ..core.stream.health import sums_findings
from ..readers.recording_sums import Provenance, RecordingSums
from .axis_result import AxisResult
from .results import Results

if TYPE_CHECKING:
    from ..core.filters.motion_factors import NoiseInMotion

OPENBLAS_FUNCTIONS = (
    'scipy_openblas_{}_num_threads64_',
    'scipy_openblas_{}_num_threads',
    'openblas_{}_num_threads64_',
    'openblas_{}_num_threads',
)
"""Names that the functions of OpenBLAS for the number of threads have in different builds, with
'get' or 'set' in place of {}."""

_lock = threading.Lock()
_users = 0
_restore = ExitStack()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenBLAS on Linux to one thread within the context.

    Several Python threads may be in the context at the same time.
    """
    global _users
    with _lock:
        if not _users:
            _limit()
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                _restore.close()


def _limit() -> None:
    """Limit OpenBLAS to one thread, and register in `_restore` how to undo this."""
    import scipy.linalg  # noqa: F401  # loads another BLAS library than numpy

    for get_number, set_number in _openblas():
        _restore.callback(set_number, get_number())
        set_number(1)


def _openblas() -> Iterator[tuple[Callable[[], int], Callable[[int], Any]]]:
    """Yield the functions that get and set the number of threads of each loaded OpenBLAS."""
    paths: set[str] = set()
    with suppress(OSError):  # the file exists only on Linux
        for line in Path('/proc/self/maps').read_text(errors='surrogateescape').splitlines():
            path = line.split(maxsplit=5)[-1]
            if 'openblas' in path.rpartition('/')[2]:
                paths.add(path)
    for path in sorted(paths):
        with suppress(OSError):
            library = ctypes.CDLL(path)
            for name in OPENBLAS_FUNCTIONS:
                if hasattr(library, name.format('set')):
                    yield getattr(library, name.format('get')), getattr(library, name.format('set'))
                    break


@one_thread()
def analyze_recorded(
    recorded: RecordingSums, method: str = 'likelihood', at_rest_before: Results | None = None
) -> Results:
    """Fit the Allan sums of one IMU, and return the results.

    Method 'likelihood' does not fit data before a lasting change of the white noise, unless the
    settings in ``recorded`` state how much time at the start is excluded.

    Parameters
    ----------
    recorded : RecordingSums
        Allan sums of one or more recordings.
    method : str
        'likelihood' or 'paper'.
    at_rest_before : Results, optional
        Earlier results. Their noise at rest is used to predict the errors in motion, instead of the
        noise at rest in ``recorded``.

    Raises
    ------
    AllanError
        When the method is unknown, or there are too few data at rest.
    """
    if not recorded.sums:
        raise AllanError('there are no Allan sums: record the IMU at rest for some minutes')
    skip = recorded.provenance.settings.get('skip', AUTO)
    may_exclude = isinstance(skip, (int, float)) and skip < 0.0
    fitted = [fit_stationary(s, method, may_exclude) for s in recorded.sums]
    sums = [s for s, _ in fitted]
    curves = [allan_curve(s) for s in sums]
    fits = [with_deviations(fit, curve) for (_, fit), curve in zip(fitted, curves)]
    # if two of the sums contain an axis, the later of them is longer, and its result is used
    axes = dict(_axis_results(zip(recorded.sums, curves, fits)))
    time_ns, celsius = recorded.temperature_readings()
    for complete_sums in recorded.sums:
        white_noise = {axis: axes[axis].fit.noise['N'].value for axis in complete_sums.axes}
        rests = at_rest(complete_sums, time_ns, celsius, white_noise)
        axes |= {axis: replace(axes[axis], at_rest=rest) for axis, rest in rests.items()}
    temperature_findings: list[Finding] = []
    if len(celsius) > 1:
        from ..core.fit.temperature import temperature_models

        for complete_sums, fit in zip(recorded.sums, fits):
            models, model_findings = temperature_models(complete_sums, time_ns, celsius, fit)
            axes |= {name: replace(axes[name], temperature=m) for name, m in models.items()}
            temperature_findings += model_findings
    largest_sums = max(sums, key=lambda s: s.samples)
    tau0 = largest_sums.tau0 or float('nan')
    noise, rest_s = axes, largest_sums.samples * tau0
    if at_rest_before is not None:
        noise, rest_s = dict(at_rest_before.axes), at_rest_before.duration_s
    hidden_findings = not_noise_findings(fits, largest_sums.samples * tau0)
    motion: NoiseInMotion | None = None
    motion_findings: tuple[Finding, ...] = ()
    if recorded.drives.errors or recorded.drives.unused:
        from .motion import is_hidden, measure_motion

        counts = recorded.provenance.counts
        moving_share = counts.moving / max(counts.received, 1)
        noise_is_hidden = at_rest_before is None and is_hidden(hidden_findings)
        motion, motion_findings = measure_motion(
            recorded.drives, noise, rest_s, moving_share, hidden=noise_is_hidden
        )
    findings = (
        *recorded.provenance.findings,
        *(f for s in sums for f in sums_findings(s)),
        *hidden_findings,
        *(f for fit in fits for f in fit.findings),
        *temperature_findings,
        *motion_findings,
    )
    return Results(
        identity=largest_sums.identity,
        method=method,
        tau0=tau0,
        samples=largest_sums.samples,
        duration_s=largest_sums.samples * tau0,
        segments=largest_sums.segment_count,
        axes={name: axes[name] for name in AXES if name in axes},
        provenance=recorded.provenance,
        findings=tuple(dict.fromkeys(findings)),
        recorded=recorded,
        motion=motion,
    )


def analyze_sums(
    sums: Sequence[AllanSums], provenance: Provenance, method: str = 'likelihood'
) -> Results:
    """Fit Allan sums in memory, for example of a running node, and return the results.

    Parameters
    ----------
    sums : sequence of AllanSums
        One item with all axes, or separate items for gyro and accelerometer.
    provenance : Provenance
        Origin of the sums.
    method : str
        'likelihood' or 'paper'.

    Raises
    ------
    AllanError
        When the method is unknown, or there are too few data at rest.
    """
    return analyze_recorded(RecordingSums('', tuple(sums), provenance), method)


def _axis_results(
    fitted: Iterable[tuple[AllanSums, AllanCurve, NoiseModel]],
) -> Iterable[tuple[str, AxisResult]]:
    for sums, curve, model in fitted:
        means = np.array([recording.mean for recording in sums.recordings])
        durations = np.array([recording.samples * model.tau0 for recording in sums.recordings])
        for i, name in enumerate(curve.axes):
            fit = model.axes[name]
            white_variance = (fit.noise['N'].value or 0.0) ** 2 / model.tau0
            axis = AxisResult(
                model.tau0,
                fit,
                curve.axis(i),
                tuple(dominant_regions(curve, fit)),
                name,
                rounding_step(sums, i, white_variance) if white_variance else None,
                turn_on_bias(means[:, i], float(fit.model.avar(durations).mean()))
                if len(means) > 1
                else None,
            )
            yield name, axis
