# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The only part of the golden test that depends on modules and attributes of the package.

`numbers` turns results into nested mappings whose names do not change when the package does. When
an attribute moves, this file follows; the golden results stay as they are.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import allan_ros as ar
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.core.stream.transport import TransportStatistics
from allan_ros.export import TARGETS
from allan_ros.readers.writing import write_recording

NUMBER = re.compile(r'(?<!\w)(?<!\w\.)[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\.?\w)')
"""Pattern of numbers in texts, also in ``1.5..2.5``, without those in names such as ``gyro_b0``."""

TERMS = ('Q', 'N', 'B', 'K', 'R')

HORIZONS = (1.0, 10.0, 30.0, 100.0, 300.0)


def numbers(results: ar.Results) -> dict[str, Any]:
    """Return everything that the results state: names -> numbers, texts, lists or mappings."""
    return {
        'samples': results.samples,
        'duration_s': results.duration_s,
        'segments': results.segments,
        'rate_hz': results.rate_hz,
        'verdict': results.level,
        'axes': {name: _axis(results[name]) for name in results},
        'findings': _findings(results.findings),
        'checks': {
            f'{c.axis} {c.quantity} against {c.reference}': {
                'verdict': c.verdict,
                'limit': c.limit,
                'at_least': c.at_least,
                'tau': c.tau,
            }
            for c in results.comparisons
        },
        'counts': _counts(results.provenance.counts),
        'export': {name: _export(results, name) for name in TARGETS},
        'export_as_measured': {
            name: _export(results, name, fidelity='coefficients')
            for name in TARGETS
            if name not in ('state_space', 'temperature')
        },
    }


def _interval(interval: Sequence[float] | None) -> list[float] | None:
    return None if interval is None else [float(end) for end in interval]


def _axis(axis: Any) -> dict[str, Any]:
    coefficients = {}
    for term in TERMS:
        signed = axis.fit.noise[term]
        found = signed.magnitude
        coefficients[term] = {
            'value': found.value,
            'ci95': _interval(found.ci95),
            'upper95': found.upper95,
            'status': found.status,
            'sign': int(np.sign(signed.value or 0.0)) if term == 'R' else 0,
        }
    curve, fit = axis.curve, axis.fit
    return {
        'coefficients': coefficients,
        'processes': _processes(axis.fit.model),
        'curve': {
            'tau': [curve.tau[0], curve.tau[-1]],
            'n': curve.n,
            'adev': curve.adev,
            'low': curve.ci_low,
            'high': curve.ci_high,
            'model': axis.model_line().adev,
        },
        'regions': {f'{i} {r.term}': [r.tau_low, r.tau_high] for i, r in enumerate(axis.regions)},
        'growth': {f'{g.horizon:g} s': [g.std.value, *(g.std.ci95 or ())] for g in axis.growth},
        'fit': {
            'm_min': fit.m_min,
            'filtered': fit.filtered,
            'gof_z': fit.gof_z,
            'lack_of_fit': [[each.low, each.high, each.ratio] for each in fit.lack_of_fit],
            'deviation': None if fit.deviation is None else [*fit.deviation],
            # of the five terms; the order of the processes may change
            'standard_errors': _standard_errors(fit.model.covariance),
        },
        'rounding': axis.rounding,
        'turn_on': _turn_on(axis.turn_on),
        'temperature': _temperature(axis.temperature),
        'at_rest': {
            'mean': axis.at_rest.mean,
            'drift': axis.at_rest.drift,
            'temperature': axis.at_rest.temperature,
            'slope': [axis.at_rest.slope.value, *(axis.at_rest.slope.ci95 or ())]
            if axis.at_rest.slope
            else [None],
            'bandwidth': axis.at_rest.bandwidth,
        },
    }


def _standard_errors(covariance: Any) -> dict[str, float] | None:
    if covariance is None:
        return None
    return dict(zip(covariance.names, np.sqrt(np.diag(covariance.matrix)).tolist()))


def _processes(model: Any) -> dict[str, Any]:
    found: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    for part in model.shaped.parts:
        process, ends, factor = part.process, part.ci95, 1.0
        kind, coefficient = process.name, process.coefficient
        if kind == 'bounded_walk':  # stated by its stationary standard deviation
            kind, factor = 'gauss_markov', (process.correlation_time / 2.0) ** 0.5
        numbers = {coefficient: [factor * x for x in (part.value, *ends)]}
        for (name, value), shape_ends in zip(process.numbers.items(), part.shape_ci95):
            numbers[name] = [value, *shape_ends]
        found.setdefault(kind, []).append((process.shape[0], numbers))
    return {
        f'{kind} {i}': numbers
        for kind, each in found.items()
        for i, (_, numbers) in enumerate(sorted(each, key=lambda one: one[0]))
    }


def _turn_on(found: Any) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        'recordings': found.recordings,
        'mean': found.mean,
        'std': found.scatter.value,
        'ci95': _interval(found.scatter.ci95),
        'upper95': found.scatter.upper95,
    }


def _temperature(found: Any) -> dict[str, Any] | None:
    if found is None:
        return None
    known = {
        name: [getattr(found, name), *getattr(found, f'{name}_ci95')]
        for name in ('b0', 'b1', 'b2', 'hysteresis')
    }
    slow = {
        f'{name} {term}': [c.value, *(c.ci95 or ()), c.upper95]
        for name, noise in (('measured', found.measured), ('corrected', found.corrected))
        for term, c in (('B', noise.B), ('K', noise.K))
    }
    return {
        'range': [found.reference, found.lowest, found.highest],
        **known,
        'resolved': found.resolved,
        'explained': found.explained,
        'averaging_time': found.averaging_time,
        **slow,
    }


def _findings(findings: Sequence[Any]) -> dict[str, Any]:
    """Return the findings by id and axes, and their values without texts."""
    found: dict[str, Any] = {}
    for each in findings:
        name = ' '.join([each.id, *each.axes])
        while name in found:
            name += ' again'
        values = each.document()['values']
        # paths of temporary files differ from run to run
        known = {key: value for key, value in values.items() if key not in ('path', 'file')}
        found[name] = {'severity': each.severity, **known}
    return found


def _counts(counts: Any) -> dict[str, Any]:
    return {name: value for name, value in vars(counts).items() if name != 'splits'} | {
        f'splits by {reason}': count for reason, count in sorted(counts.splits.items())
    }


def _export(results: ar.Results, target: str, **options: Any) -> Any:
    """Return the numbers of an exported file, without its comments.

    Of state spaces, whose states may be chosen differently, it is the standard deviation of the
    integrated samples after several times.
    """
    try:
        text = results.export(target, **options)
    except ar.AllanError:
        return 'refused'
    if target == 'state_space':
        document = json.loads(text)
        axes = document['axes'].items()
        return {name: _integrated(axis, document['rate_hz']) for name, axis in axes}
    text = re.sub(r'(?s)<!--.*?-->|""".*?"""', '', text)
    if target in ('basalt', 'glim'):
        text = json.dumps(_without_texts(json.loads(text)), indent=1)
    found: dict[str, Any] = {}
    for line in text.splitlines():
        code = re.sub(r'\s+(?:#|//).*|^(?:#|//).*', '', line).strip()
        values = [float(number) for number in NUMBER.findall(code)]
        if values:
            key = f'{len(found)} {NUMBER.sub("#", code)}'
            found[key] = values if len(values) > 1 else values[0]
    return found


def _without_texts(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_texts(inner) for key, inner in value.items()}
    return [v for v in value if not isinstance(v, str)] if isinstance(value, list) else value


def _integrated(axis: Mapping[str, Any], rate: float) -> list[float]:
    """Return the standard deviation of the first state after `HORIZONS`, if all start at 0."""
    phi, noise = np.array(axis['Phi']), np.array(axis['Qd'])
    found = []
    for horizon in HORIZONS:
        steps = round(horizon * rate)
        total, power, covariance = np.zeros_like(noise), phi, noise
        while steps:  # doubling: the covariance after 2n steps follows from the one after n
            if steps % 2:
                total = power @ total @ power.T + covariance
            covariance = power @ covariance @ power.T + covariance
            power = power @ power
            steps //= 2
        found.append(float(np.sqrt(total[0, 0])))
    return [*found, axis['R']]


def statuses(results: ar.Results, batches: Sequence[ImuBatch]) -> dict[str, Any]:
    """Return the values of the statuses that the nodes would publish about these results.

    ``batches`` are the samples, from which the status of the input is computed.
    """
    from allan_ros.nodes.diagnostics import FIT_NOTES, AxisView, axis_status, input_status

    known = {axis: sums for sums in results.recorded.sums for axis in sums.axes}
    found = {}
    for name in results:
        view = AxisView(
            axis=name,
            sums=known[name],
            result=results[name],
            method=results.method,
            fit_age_s=0.0,
            problems=(),
            comparisons=tuple(c for c in results.comparisons if c.axis == name),
            margin=results.margin,
            step=None,
            noted=tuple(f for f in results.findings if f.id in FIT_NOTES and name in f.axes),
        )
        found[name] = _status(axis_status(name, 'SN 7', view))
    stream = ImuStream()
    for batch in batches:
        stream.update(batch)
    stream.end()
    state = stream.result()
    received = TransportStatistics(received=state.health.counts.received)
    static_s = sum(sums.elapsed_ns for sums in state.sums[:1]) * 1e-9
    status = input_status('imu', 'SN 7', state.health, received, state.findings, static_s=static_s)
    return {**found, 'imu': _status(status)}


def _status(status: Any) -> dict[str, Any]:
    """Return level, numbers in the message, and values; of texts of findings only their keys."""
    values: dict[str, Any] = {}
    for pair in status.values:
        found = [float(number) for number in NUMBER.findall(pair.value)]
        words = NUMBER.sub('#', pair.value)
        is_text = pair.key.startswith('finding: ')
        values[pair.key] = 'present' if is_text else found if words == '#' else words
        if found and words != '#' and not is_text:
            values[f'{pair.key} numbers'] = found
    level = int.from_bytes(status.level, 'little')
    return {'level': level, 'message': [float(n) for n in NUMBER.findall(status.message)], **values}


def batch_of(stamps_ns: Any, samples: Any) -> ImuBatch:
    """Return samples, (n, 6), with their stamps in ns, (n,)."""
    return ImuBatch(np.asarray(stamps_ns, np.int64), samples, None, 'imu_link')


def write_bag(path: Path, batch: ImuBatch) -> Path:
    """Write the samples as an mcap bag."""
    write_recording(path, [batch])
    return path
