# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Addition of sums, parts of them, pooled spectra, and conversion to a document and back."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.sums import noise
from support.sums import sums_of as without_names

from allan_ros.core.allan.cascade import BLOCK
from allan_ros.core.allan.curve import noise_density, pooled_spectra
from allan_ros.core.allan.document import _packed, checksum_of, sums_from_document, sums_to_document
from allan_ros.core.allan.periods import KEPT_SEGMENTS, MAX_MEANS, MAX_PERIODS
from allan_ros.core.allan.sums import AllanSums, part
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuIdentity

AXES = ('gyro_x', 'gyro_y', 'accel_z')


def sums_of(y, chunks=None, cuts=(), first=0):
    sums = without_names(y, chunks, cuts)
    (recording,) = sums.recordings
    moved = tuple(replaced(p, begin_ns=p.begin_ns + first) for p in recording.periods)
    recording = replaced(recording, periods=moved)
    return replaced(sums, axes=AXES[: y.shape[1]], recordings=(recording,))


def replaced(value, **fields):
    return type(value)(**{**value.__dict__, **fields})


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 9000), min_size=2, max_size=40), st.integers(0, 99))
def test_adding_equals_accumulating_both_in_any_order(lengths, seed):
    y = noise(sum(lengths), seed, 3)
    cuts = np.cumsum(lengths)[:-1].tolist()
    together = sums_of(y, cuts=cuts)
    parts = [
        sums_of(y[a:b], first=10**12 * i)
        for i, (a, b) in enumerate(zip([0, *cuts], [*cuts, len(y)]))
    ]
    added = AllanSums.empty(ImuIdentity('imu'), AXES)
    for one in parts:
        added = added + one
    other = parts[-1]
    for one in parts[:-1]:
        other = one + other
    for found in (added, other):
        assert np.array_equal(found.count, together.count)
        assert found.sum_sq == pytest.approx(together.sum_sq, rel=1e-12)
        assert found.group_sum_sq == pytest.approx(together.group_sum_sq, rel=1e-12)
        assert found.samples == together.samples == len(y)
        assert found.intervals == together.intervals == len(y) - len(parts)
        assert found.lengths == together.lengths
        assert len(found.periods) <= MAX_PERIODS
        a, b = pooled_spectra(found), pooled_spectra(together)
        assert np.array_equal(a.blocks, b.blocks) and np.array_equal(a.pairs, b.pairs)
        assert a.power == pytest.approx(b.power, rel=1e-5) and np.array_equal(a.dof, b.dof)
        means = [m for r in found.recordings for m in r.means]
        assert len(means) <= KEPT_SEGMENTS and len({m.step for m in means}) <= 1
        assert sum(len(m.values) for m in means) <= MAX_MEANS
        total = sum(r.mean * r.samples for r in found.recordings)
        assert total == pytest.approx(y.sum(axis=0), rel=1e-9)
        for r in found.recordings:
            for m in r.means:
                at = m.start_ns // 10**7  # all parts begin at 0
                own = next(p for p, n in zip(parts, lengths) if n == m.samples)
                assert at == 0 and own.samples == m.samples
        begins = [r.periods[0].begin_ns for r in found.recordings]
        assert begins == sorted(begins)


def test_adding_empty_sums_changes_nothing():
    sums = sums_of(noise(50_000, axes=3))
    empty = AllanSums.empty(ImuIdentity('imu'), AXES)
    assert empty + sums == sums and sums + empty == sums
    assert empty.tau0 is None and len(empty.avar) == 0 and noise_density(empty) is None
    assert pooled_spectra(empty).power.shape == (0, 3)


def test_sums_of_other_axes_or_rates_are_not_added():
    sums = sums_of(noise(500, axes=3))
    with pytest.raises(AllanError, match='axes'):
        sums + sums_of(noise(500))
    with pytest.raises(AllanError, match='different IMUs') as error:
        sums + replaced(sums, identity=ImuIdentity('imu', '7'))
    assert 'frame_id imu, serial number unknown; frame_id imu, serial number 7' in str(error.value)
    with pytest.raises(AllanError, match='frame_id base_imu, serial number unknown'):
        sums + replaced(sums, identity=ImuIdentity('base_imu'))
    # 1 % exceeds 0.1 % plus the ends of a segment of 500 samples (2 x 0.4 %)
    with pytest.raises(AllanError, match='rates are more than'):
        sums + replaced(sums, elapsed_ns=sums.elapsed_ns * 101 // 100)
    close = replaced(sums, elapsed_ns=sums.elapsed_ns * 100_05 // 100_00)
    assert (sums + close).samples == 1000


def test_a_recording_without_a_frame_id_can_be_added_to_any_other():
    named = sums_of(noise(500, axes=3))
    unnamed = replaced(named, identity=ImuIdentity())
    assert unnamed + named == named + unnamed == named + named
    assert (unnamed + unnamed).identity == ImuIdentity()


def test_a_part_is_near_the_sums_of_its_samples():
    """Equal at long times and exact in its means; at short times a few differences are missing."""
    y = noise(400_000)
    sums = sums_of(y)
    assert part(sums, 0).sum_sq == pytest.approx(sums.sum_sq, rel=1e-5)
    for first in (3, 7, -8):
        found = part(sums, first)
        begin, end = found.periods[0].begin, found.periods[-1].end
        expected = sums_of(y[begin:end])
        assert found.samples == expected.samples and found.lengths == expected.lengths
        assert found.tau0 == pytest.approx(expected.tau0)
        assert found.recordings[0].mean == pytest.approx(y[begin:end].mean(axis=0), rel=1e-9)
        (means,) = found.recordings[0].means
        age, step = means.age, means.step
        used = y[age : age + step * len(means.values)]
        assert begin <= age and age + means.samples <= end and means.start_ns == age * 10**7
        values = used.reshape(-1, step, 2).mean(axis=1) - sums.recordings[0].reference
        assert means.values == pytest.approx(values, rel=1e-8, abs=1e-8)
        long = expected.m >= 8 * step
        assert np.array_equal(found.m, expected.m)
        assert np.all(np.abs(found.count - expected.count) <= BLOCK * expected.m)
        ratio = found.avar / expected.avar
        assert np.all(np.abs(ratio[long] - 1.0) < 0.2)
        assert np.all(np.abs(ratio[found.count > 3000] - 1.0) < 0.1)


def test_the_density_of_white_noise_is_its_level():
    y = np.random.default_rng(4).normal(size=(200_000, 1))
    density = noise_density(sums_of(y))
    covered = (density.low <= 0.02) & (density.high >= 0.02)
    assert np.all(np.diff(density.frequency) > 0.0)
    assert 0.55 < covered.mean() < 0.8
    assert density.psd[density.frequency > 1.0].mean() == pytest.approx(0.02, rel=0.01)


@settings(max_examples=20, deadline=None)
@given(
    st.integers(1, 30_000),
    st.lists(st.integers(1, 29_999), max_size=50),
    st.floats(-30.0, 28.0),
    st.integers(1, 30),
)
def test_document_round_trips_through_json(n, cuts, decades, copies):
    sums = sums_of(noise(n, axes=3) * 10.0**decades, cuts=sorted({c for c in cuts if c < n}))
    for _ in range(copies - 1):
        sums = sums + sums_of(noise(n, axes=3) * 10.0**decades)
    assert sums_from_document(json.loads(json.dumps(sums_to_document(sums)))) == sums


def test_a_document_of_ten_hours_is_small():
    """At 100 Hz; the size depends on the logarithm of the length."""
    y = np.random.default_rng(0).normal(size=(450_000, 6)) + 9.8
    sums = without_names(y)
    assert len(json.dumps(sums_to_document(replaced(sums, axes=('gyro_x',) * 6)))) < 150_000


def spoilers():
    """Return changes that make a document invalid, each with a word of the error message."""
    one = lambda d: d['recordings'][0]  # noqa: E731
    return {
        'schema': (lambda d: d.update(schema='allan_ros/sums/2'), 'schema'),
        'no schema': (lambda d: d.pop('schema'), 'schema'),
        'axes': (lambda d: d.update(axes=['accel_z', 'gyro_x']), 'axes'),
        'no axes': (lambda d: d.update(axes=[]), 'axes'),
        'nan': (lambda d: d['sum_sq'][0].__setitem__(0, float('nan')), 'sum_sq'),
        'inf': (lambda d: one(d).update(reference=_packed(np.full(3, np.inf))), 'reference'),
        'negative': (lambda d: d['sum_sq'][0].__setitem__(0, -1.0), '0 or above'),
        'huge': (lambda d: d['sum_sq'][0].__setitem__(0, 10**400), 'sum_sq'),
        'ragged': (lambda d: d['sum_sq'][0].pop(), 'table'),
        'text': (lambda d: d.update(intervals='many'), 'whole number'),
        'true': (lambda d: d.update(intervals=True), 'whole number'),
        'overflow': (lambda d: d.update(elapsed_ns=2**63), 'whole number from'),
        'count': (lambda d: d['count'].__setitem__(0, 1.5), 'whole numbers'),
        'recordings': (lambda d: d.update(recordings=d['recordings'] * 25), 'at most'),
        'step': (lambda d: one(d)['means'][0].update(step=3), 'power of two'),
        'means': (lambda d: one(d)['means'][0].update(samples=4), 'expected'),
        'long means': (lambda d: one(d)['means'][0].update(samples=10**9), 'too many'),
        'grid': (lambda d: d['m'].__setitem__(0, 2), 'averaging factors'),
        'list': (lambda d: d.update(recordings=[[]]), 'keys with values .* are expected'),
        'name': (lambda d: d.update(frame_id='x' * 5000), 'frame_id'),
        'lengths': (lambda d: d.update(lengths=[[5000, 0]]), 'lengths'),
        'length': (lambda d: d.update(lengths=[[2**62, 1]]), 'lengths'),
        'not base64': (lambda d: one(d).update(power='?'), 'unpacked'),
        'other size': (lambda d: one(d).update(power=one(d)['count']), 'power'),
        'truncated': (lambda d: one(d).update(power=one(d)['power'][:-9]), 'power'),
        'no periods': (lambda d: one(d).update(periods=0), 'periods'),
        'many periods': (lambda d: one(d).update(periods=2**40), 'too many'),
        'octaves': (lambda d: one(d).update(octaves=40), 'expected'),
    }


@pytest.mark.parametrize('name', spoilers())
def test_an_invalid_document_is_rejected_with_one_line(name):
    document = copy.deepcopy(sums_to_document(sums_of(noise(9000, axes=3))))
    spoil, word = spoilers()[name]
    spoil(document)
    document['checksum'] = checksum_of(document)
    with pytest.raises(AllanError, match=word) as error:
        sums_from_document(document)
    assert '\n' not in str(error.value) and len(str(error.value)) < 300


@pytest.mark.parametrize('name', ['count', 'elapsed_ns', 'lengths', 'recordings'])
def test_damage_is_named_as_damage(name):
    """Also where the changed document has numbers within all bounds."""
    document = json.loads(json.dumps(sums_to_document(sums_of(noise(9000, axes=3)))))
    sums_from_document({**document, 'frame_id': 'other'})
    value = document[name]
    document[name] = value + 1 if isinstance(value, int) else value[::-1] * 2
    with pytest.raises(AllanError, match='damaged'):
        sums_from_document(document)


@pytest.mark.parametrize('thing', [None, 3, 'sums', [], {}])
def test_a_value_that_is_not_a_document_is_rejected(thing):
    with pytest.raises(AllanError):
        sums_from_document(thing)
