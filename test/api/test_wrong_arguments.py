# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A wrong argument of a public function raises an `AllanError` with a one-line message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.core.allan.curve import AxisCurve
from allan_ros.core.imu import ImuBatch
from allan_ros.core.settings import check_choice, expect
from allan_ros.readers.files import PATH

SOURCE = 'source is {}: results or a path is expected'
TAUS = np.geomspace(0.1, 1000.0, 30)
PAIR = ([1.0, 2.0], [1.0, 0.7])
W = np.random.default_rng(0).normal(size=100)
STAMPS, SIX = np.arange(100), np.ones((100, 6))

CALLS = [
    (lambda r: ar.load(5), 'path is 5: a path is expected'),
    (lambda r: ar.load(r), 'path is .*: a path is expected'),
    (lambda r: ar.compare(r, 5), SOURCE.format(5)),
    (lambda r: ar.compare(r, r, sensor=5), 'sensor is 5: a datasheet or a list'),
    (lambda r: ar.compare(r, r, margin='x'), "margin is 'x': a number is expected"),
    (lambda r: ar.compare(r, r, margin=float('nan')), 'margin is nan: it must lie between 0 and'),
    (lambda r: ar.compare(r, r, method='x'), "method is 'x': choose one of likelihood"),
    (lambda r: ar.compare(r), 'nothing to compare'),
    (lambda r: ar.fit(3), 'the curve is not a pair of lists tau and adev'),
    (lambda r: ar.fit((1, 2, 3)), 'the curve is not a pair of lists tau and adev'),
    (lambda r: ar.fit('abc'), 'give these, or an AxisCurve'),
    (lambda r: ar.fit(PAIR, axis=[]), r'axis is \[\]: choose one of gyro_x'),
    (lambda r: ar.fit(PAIR, record='x'), "record is 'x': a number is expected"),
    (lambda r: ar.fit((TAUS, TAUS), record=-1), 'a recording of -1 s has no average over 1000 s'),
    (lambda r: ar.fit((TAUS, -TAUS)), 'the curve has 0 usable points: give at least 6'),
    (lambda r: ar.analyze([]), 'the list of sources is empty'),
    (lambda r: ar.analyze(np.ones(1), rate=1), 'no static data in 1 sample: it is too short'),
    (lambda r: ar.simulate('a'), "hours is 'a': a number is expected"),
    (lambda r: ar.simulate(0.01, None), 'rate is None: a number is expected'),
    (lambda r: ar.simulate(True), 'hours is True: a number is expected'),
    (lambda r: ar.simulate(float('inf')), 'hours is inf: it must lie between 0 and'),
    (lambda r: ar.simulate(10**400), 'it must lie between 0 and 1e'),
    (lambda r: ar.simulate(0.01, rate=1e-300), 'rate is 1e-300: it must lie between'),
    (lambda r: ar.simulate(0.01, motion=[(1,)]), r'motion has \(1,\): give \(start, length\)'),
    (lambda r: ar.simulate(0.01, motion=[('a', 1)]), "start of motion is 'a': a number"),
    (lambda r: ar.simulate(0.01, gaps=[5]), r'gaps is 5: \(start, length\) is expected'),
    (lambda r: ar.simulate(0.01, low_pass=float('inf')), 'low_pass is inf'),
    (lambda r: ar.simulate(0.01, sensor='a' * 5000), 'File name too long'),
    (lambda r: ar.analyze('a' * 5000), 'File name too long'),
    (lambda r: ar.sensor('a' * 5000), 'File name too long'),
    (lambda r: ar.analyze(np.ones(900), rate=1e-300), 'rate is 1e-300: it must lie between'),
    (lambda r: ar.analyze(np.ones(900), rate=9, sensor='a' * 5000), 'File name too long'),
    (lambda r: ar.analyze('x', baseline='\0'), r"^'\\x00' has a null character"),
    (lambda r: ar.analyze('x', columns=(1, 2)), 'columns is 1: a text is expected'),
    (lambda r: ar.load('a\0b'), 'has a null character'),
    (lambda r: ar.load(path=''), '^path is an empty text: give a path or a name$'),
    (lambda r: ar.analyze(''), 'source is an empty text'),
    (lambda r: ar.analyze(['nowhere', '']), 'source is an empty text'),
    (lambda r: ar.compare(r, ''), 'sources is an empty text'),
    (lambda r: ar.inflate(r, ''), 'running is an empty text'),
    (lambda r: r.save(''), 'folder is an empty text'),
    (lambda r: r.export('openvins', ''), 'path is an empty text'),
    (lambda r: r.export('openvins', 'x', overwrite=1), 'overwrite is 1: True or False'),
    (lambda r: r.check(sensor='a' * 5000), 'File name too long'),
    (lambda r: ar.inflate(r, r, horizon=float('inf')), 'horizon is inf: it must lie between'),
    (lambda r: ar.simulate(0.01, seed=1.5), 'seed is 1.5: a whole number is expected'),
    (lambda r: ar.simulate(0.01, seed=-1), 'seed is -1: give a whole number of 0 or more'),
    (lambda r: ar.simulate(0.01, sensor=5), 'sensor is 5: a text is expected'),
    (lambda r: ar.simulate(0.01, frame_id=5), 'frame_id is 5: a text is expected'),
    (lambda r: ar.simulate(0.01, gyro=5), 'gyro is 5: '),
    (lambda r: ar.simulate(1e6), 'samples do not fit into memory: reduce the'),
    (lambda r: ar.analyze(['a', 'b'], processes='x'), "processes is 'x': a whole number"),
    (lambda r: ar.analyze(np.ones(9), rate=1, hardware_id=5), 'hardware_id is 5: a text'),
    (lambda r: ar.analyze(np.ones(9), rate=1, axes=5), 'axes is 5: a text or a list'),
    (
        lambda r: ar.analyze(np.ones(9), rate=1, method=[]),
        r'method is \[\]: choose one of likelihood',
    ),
    (lambda r: ar.analyze('x', topik='/imu'), "option 'topik' is unknown: use topic$"),
    (lambda r: ar.analyze('x', foo=1), "option 'foo' is unknown: use stamps, .*, topic, .*columns"),
    (lambda r: ar.analyze('x', rate_hz=9.0), "option 'rate_hz' is unknown"),
    (lambda r: ar.analyze('x', axes='gyro'), 'axes are for arrays, not files: name the columns'),
    (lambda r: ar.analyze('x', rate=-1), r'^rate is -1: it must lie between 1e-06 and 1e\+06 Hz'),
    (lambda r: ar.analyze('x', max_bridge=np.int64(-1)), 'max_bridge is -1: it must lie between'),
    (lambda r: ar.adev([1.0, 2.0], rate='x'), "rate is 'x': a number is expected"),
    (lambda r: ar.adev([1.0, np.nan]), '1 of 2 samples are NaN or infinite'),
    (lambda r: ar.adev(np.zeros((2, 2, 2))), r'samples of shape \(2, 2, 2\)'),
    (lambda r: ar.adev(['a', 'b']), 'the samples are not numbers'),
    (lambda r: ar.analyze(W + 1j, rate=9), 'the samples are not numbers .complex values'),
    (lambda r: ar.analyze(W, rate='9'), "rate is '9': a number is expected"),
    (lambda r: ar.analyze(W, rate=9, margin='a'), "margin is 'a': a number is expected"),
    (lambda r: ar.analyze(W, rate=9, skip='x'), "skip is 'x': a number is expected"),
    (lambda r: ar.analyze(W, rate=9, motion_gate=3), 'motion_gate is 3: True or False is'),
    (lambda r: ar.analyze(W, rate=9, motion_gat=False), 'use motion_gate'),
    (lambda r: ar.analyze(W, rate=9, columns='gx'), "columns is 'gx': a list is expected"),
    (lambda r: ar.analyze(W, rate=9, gyro_unit='g'), 'gyro_unit is .*: choose one of rad/s, mrad'),
    (lambda r: ar.analyze(W, rate=9, axes='gyro'), '1 columns, but 3 axes'),
    (lambda r: ar.analyze(W, rate=9, axes='yaw'), "axis 'yaw' is unknown"),
    (lambda r: ar.analyze(W), 'rate=200'),
    (lambda r: ar.analyze(W[:0], rate=9), 'no samples'),
    (lambda r: ar.analyze(W * np.nan, rate=9), 'data: the values are NaN.*Check the columns'),
    (lambda r: ar.analyze(np.zeros((9, 4)), rate=9), 'and name the columns'),
    (
        lambda r: ar.analyze(np.zeros((9, 2)), rate=9, axes=['gyro_x'] * 2),
        'and one axis per column',
    ),
    (lambda r: ar.analyze(np.zeros((6, 900)), rate=9), 'of 900 columns .* one row per sample'),
    (lambda r: ar.analyze(np.zeros((3, 900)), rate=9, axes='gyro'), 'give one row per sample'),
    (lambda r: ar.analyze(np.zeros((9, 3, 2)), rate=9), 'shape'),
    (lambda r: ar.analyze({'time': W, 'x': W}), 'accel axis: name the columns'),
    (
        lambda r: ar.analyze({'time': np.array([0, np.nan]), 'gx': W[:2]}),
        'time of row 1 is not',
    ),
    (lambda r: ar.analyze({'gx': W, 'gy': W[1:]}, rate=9), 'different lengths'),
    (lambda r: ar.analyze(object(), rate=9), 'not numbers'),
    (lambda r: ar.analyze('nowhere.mcap'), 'no such file'),
    (lambda r: ar.fit(ar.adev(np.ones((9, 2)))), 'the curve has several columns'),
    (lambda r: ar.fit(AxisCurve(*[np.zeros(0)] * 6)), 'the curve has no points'),
    (lambda r: ar.fit(([0.0, 1.0], [1.0, 1.0])), 'give two lists of equal length'),
    (lambda r: ar.fit((np.r_[TAUS, np.inf], np.r_[TAUS, 1.0])), 'with positive, finite tau'),
    (lambda r: ar.simulate(preset='nope'), 'preset'),
    (lambda r: ar.simulate(low_pas=3.0), 'use low_pass'),
    (lambda r: ar.simulate(-1), 'must lie between 0 and'),
    (lambda r: ar.simulate(gyro=[{'N': 1.0}]), 'a mapping of terms is expected'),
    (lambda r: ar.simulate(gyro={'z': 1.0}), 'noise.gyro_z is 1.0: an object'),
    (lambda r: r.export('kalibr', foo=3), r'option .foo. is unknown'),
    (lambda r: ar.inflate(r, None), SOURCE.format('None')),
    (lambda r: ar.inflate(r, r, horizon='x'), "horizon is 'x': a number is expected"),
    (lambda r: r[[]], r'there is no axis \[\]: choose one of gyro_x'),
    (lambda r: r.table('foo'), "units is 'foo': choose one of deg/h, SI"),
    (lambda r: r.plot(units=5), 'units is 5: choose one of deg/h, SI'),
    (lambda r: r.plot(ax=5), 'ax is 5: a matplotlib Axes is expected'),
    (lambda r: r.export(5), 'target is 5: a text is expected'),
    (lambda r: r.export('kalibr', 5), 'path is 5: a path is expected'),
    (lambda r: r.save(None), 'folder is None: a path is expected'),
    (lambda r: r.save('x', targets='kalibr'), "targets is 'kalibr': a list is expected"),
    (lambda r: r.save('x', units='foo'), "units is 'foo': choose one of deg/h, SI"),
    (lambda r: r.save('x', plots=('gif',)), "plots is 'gif': choose one of png, svg, pdf"),
    (lambda r: r.check([]), r'sensor is \[\]: a datasheet or its name is expected'),
    (lambda r: r.check(baseline=5), 'baseline is 5: results or a path is expected'),
    (lambda r: r.check('adis16475-3', margin=-1), 'margin is -1: give 0 or more'),
    (lambda r: r['gyro_x'].N.to(5), 'unit is 5: a text is expected'),
    (lambda r: r['gyro_x'].quantity('X'), "term is 'X': choose one of Q, N, B, K, R"),
    (lambda r: r['gyro_x'].total_adev('x'), "m is 'x': an array of averaging factors"),
    (lambda r: r['gyro_x'].total_adev(None), 'm is None: averaging factors above 0'),
    (lambda r: r['gyro_x'].limit_adev([0, 1]), r'm is \[0, 1\]: averaging factors above 0'),
    (lambda r: r['gyro_x'].total_adev(np.inf), 'm is inf: averaging factors above 0'),
    (lambda r: r['gyro_x'].state_space().transition('x'), "step is 'x': a number is expected"),
    (lambda r: ar.simulate(0.01, frame_id='a' * 2000), 'frame_id has 2000 characters'),
    (lambda r: ar.analyze(W, rate=9, hardware_id='a' * 2000), 'hardware id has 2000 characters'),
    (lambda r: ar.adev([1.0, 10**400]), 'the samples are not numbers .int too large'),
    (lambda r: ar.analyze(W, rate=9, skip=W), 'skip is array.*: a number is expected'),
    (lambda r: ar.analyze(W, rate=9, axes=[W]), 'axis array.* is unknown'),
    (lambda r: ar.analyze({'t': 3, 'gx': W}), r'samples have shape \(\)'),
    (lambda r: r.plot(W), 'there is no axis or sensor array'),
    (lambda r: r.save('x', targets=[[]]), r'target is \[\]: a text is expected'),
    (lambda r: r['gyro_x'].state_space().noise(10**400), 'the step is 1000'),
    (lambda r: ar.adev(W, rate=10**400), r'samples of shape \(100,\) at 1000'),
    (lambda r: ar.adev(W + 1j), 'the samples are not numbers .complex values'),
    (lambda r: ar.fit((TAUS, 1j * TAUS)), 'the curve is not a pair of lists .*complex values'),
    (lambda r: ar.fit((TAUS, TAUS), record=10**400), 'a recording of 1000'),
    (lambda r: r.save('x', targets=[3]), 'target is 3: a text is expected'),
    (lambda r: r.check(margin=10**400), 'margin is 1000'),
    (lambda r: r.compared(baseline='\0'), 'has a null character'),
    (lambda r: r.against_datasheet('bmi088', 0.2), "datasheet is 'bmi088': a datasheet, such as"),
    (lambda r: r.against_datasheet(ar.sensor('bmi088'), np.nan), 'margin is nan: it must be at'),
    (lambda r: ar.analyze(ImuBatch(STAMPS, np.ones((100, 3)))), 'of six axes'),
    (lambda r: ar.analyze(ImuBatch(np.nan * STAMPS, SIX)), 'give int64 stamps'),
    (lambda r: ImuBatch(STAMPS[:, None], SIX), 'a batch of 100 stamps needs samples of shape'),
]


@pytest.mark.parametrize('call, message', CALLS, ids=[message[:30] for _, message in CALLS])
def test_a_wrong_argument_gives_one_line(call, message, small_results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ar.AllanError, match=message) as error:
        call(small_results)
    assert '\n' not in str(error.value) and len(str(error.value)) < 300
    assert not list(tmp_path.iterdir())


def test_averaging_factors_may_be_any_sequence(small_results):
    axis = small_results['gyro_x']
    assert (axis.total_adev([1, 2]) == axis.total_adev(np.array([1, 2]))).all()


def test_kinds_and_choices():
    expect(PATH, 'a path', path=Path('x'))
    expect(PATH, 'a path', path='x')
    check_choice(('', 'a'), name='')
    with pytest.raises(ar.AllanError, match=r'name is 3: choose one of a, b$'):
        check_choice(('', 'a', 'b'), name=3)
