# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table of filters and calibration tools: keys, convention and form of each file.

Each convention was read from the source file that it names. N and K in formulas are the continuous
densities, f the rate in Hz.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

from ...core.filters.noise_parameters import (
    madgwick_drift_gain,
    madgwick_gain,
    madgwick_ramp_gain,
)
from ...core.findings import finding
from ...core.imu import HOUR, UNITS
from .convention import INS_HORIZON_S, Convention, Entry, Value
from .json_form import JsonForm
from .model import FilterNoise, KeyedTerms, clamped, rounded
from .target import Target
from .text_forms import LineForm, MatlabForm, PythonForm
from .yaml_form import YamlForm

ANY_NODE = ('/**', 'ros__parameters')
"""Parameters of whatever node the file is loaded into by --params-file."""


def keys(noise: str, accel_noise: str, walk: str, accel_walk: str) -> KeyedTerms:
    """Return the keys of N and K of the gyro and the accelerometer."""
    return {
        noise: ('gyro', 'N'),
        accel_noise: ('accel', 'N'),
        walk: ('gyro', 'K'),
        accel_walk: ('accel', 'K'),
    }


def table(
    keyed: KeyedTerms,
    quantity: str = 'density',
    parent: tuple[str, ...] = (),
    rate_key: str = '',
) -> Callable[[FilterNoise], Iterator[Entry]]:
    """Return the entries of a file whose numbers are all of one quantity.

    Parameters
    ----------
    keyed : mapping of key to (sensor, term)
    quantity : str
        One of `QUANTITIES`.
    parent : tuple of str
        The mappings that contain the keys.
    rate_key : str
        Key of the rate, if the file has one.
    """

    def entries(noise: FilterNoise) -> Iterator[Entry]:
        yield from noise.keyed(keyed, quantity, parent)
        if rate_key:
            yield Entry((*parent, rate_key), noise.rate)

    return entries


# --- Kalibr and OpenVINS --------------------------------------------------------------------------

KALIBR_KEYS = {
    'accelerometer_noise_density': ('accel', 'N'),
    'accelerometer_random_walk': ('accel', 'K'),
    'gyroscope_noise_density': ('gyro', 'N'),
    'gyroscope_random_walk': ('gyro', 'K'),
}

DEFAULT_TOPIC = '/imu0'
"""As in the examples of Kalibr."""


def _identity(size: int) -> list[list[float]]:
    return [[float(i == j) for j in range(size)] for i in range(size)]


OPENVINS_NOT_MEASURED: dict[str, Value] = {
    'T_i_b': _identity(4),
    'time_offset': 0.0,
    'model': 'kalibr',
    'Tw': _identity(3),
    'R_IMUtoGYRO': _identity(3),
    'Ta': _identity(3),
    'R_IMUtoACC': _identity(3),
    'Tg': [[0.0] * 3] * 3,
}
"""Required keys: an IMU without errors of scale, axes and time."""


def _kalibr(noise: FilterNoise, parent: tuple[str, ...] = ()) -> Iterator[Entry]:
    yield from noise.keyed(KALIBR_KEYS, parent=parent)
    given = noise.options.topic
    topics = [source.topic for source in noise.results.provenance.sources if source.topic]
    topic = given or next(iter(topics), DEFAULT_TOPIC)
    yield Entry((*parent, 'rostopic'), topic, keep=not given)
    yield Entry((*parent, 'update_rate'), noise.rate)


def _openvins(noise: FilterNoise) -> Iterator[Entry]:
    yield from _kalibr(noise, ('imu0',))
    for key, value in OPENVINS_NOT_MEASURED.items():
        yield Entry(('imu0', key), value, keep=True)


# --- visual and lidar odometry --------------------------------------------------------------------


def _vins_fusion(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the keys of VINS.

    The midpoint rule halves two samples and gives each a noise of its own: V noise V' adds
    gyr_n^2 dt^2 / 2 to the variance of the angle, although white noise adds N^2 dt. The customary
    N sqrt(f) thus propagates half the variance; N sqrt(2f) propagates all of it. The bias block of
    V is dt, so K^2 dt needs gyr_w = K sqrt(f).
    """
    exact = noise.options.exact
    said = () if exact else (finding('export_half_of_noise', keys='acc_n and gyr_n'),)
    white = {'acc_n': ('accel', 'N'), 'gyr_n': ('gyro', 'N')}
    for entry in noise.keyed(white, 'midpoint' if exact else 'std'):
        yield replace(entry, findings=said)
    yield from noise.keyed({'acc_w': ('accel', 'K'), 'gyr_w': ('gyro', 'K')}, 'std')


def _basalt(noise: FilterNoise) -> Iterator[Entry]:
    yield Entry(('value0', 'imu_update_rate'), noise.rate)
    keyed = {
        'accel_noise_std': ('accel', 'N'),
        'gyro_noise_std': ('gyro', 'N'),
        'accel_bias_std': ('accel', 'K'),
        'gyro_bias_std': ('gyro', 'K'),
    }
    yield from noise.keyed(keyed, parent=('value0',))


GTSAM_CODE = '''
# Error of the numerical integration, not of the IMU; the default is the identity.
integrationCovariance = [1e-08] * 3


def set_noise(params):
    """Set this noise on a gtsam.PreintegrationCombinedParams (or PreintegrationParams)."""
    params.setAccelerometerCovariance(np.diag(accelerometerCovariance))
    params.setGyroscopeCovariance(np.diag(gyroscopeCovariance))
    params.setIntegrationCovariance(np.diag(integrationCovariance))
    if hasattr(params, 'setBiasAccCovariance'):
        params.setBiasAccCovariance(np.diag(biasAccCovariance))
        params.setBiasOmegaCovariance(np.diag(biasOmegaCovariance))
    if hasattr(params, 'setBiasAccOmegaInit'):
        # Up to GTSAM 4.2 the default is the identity, which exceeds the IMU by far. The uncertainty
        # of the initial bias belongs into the prior factor of the bias.
        params.setBiasAccOmegaInit(np.zeros((6, 6)))
    return params
'''

# --- autopilots -----------------------------------------------------------------------------------

FLOOR_NOTE = (
    'this is the noise at rest, a floor: propellers, vibration and clipping add to it, and the '
    'defaults of the autopilot allow for them; use lower values only after checking the logs'
)

Ranges = Mapping[str, tuple[float, float]]


def _ranged(keyed: KeyedTerms, ranges: Ranges, noise: FilterNoise) -> Iterator[Entry]:
    """Yield the parameters of an autopilot, within the ranges that it accepts.

    EKF2 and EK3 add (dt noise)^2 to the variance of angle and velocity and (dt bias_noise)^2 to
    that of the bias, with dt the step of the filter; samples are averaged to it before.
    """
    for entry in noise.keyed(keyed, 'std'):
        yield clamped(entry, *ranges[entry.key])


PX4_RANGES = {
    'EKF2_GYR_NOISE': (1e-4, 0.1),
    'EKF2_ACC_NOISE': (0.01, 1.0),
    'EKF2_GYR_B_NOISE': (0.0, 0.01),
    'EKF2_ACC_B_NOISE': (0.0, 0.01),
}

ARDUPILOT_RANGES = {
    'EK3_GYRO_P_NSE': (1e-4, 0.1),
    'EK3_ACC_P_NSE': (0.01, 1.0),
    'EK3_GBIAS_P_NSE': (1e-5, 1e-3),
    'EK3_ABIAS_P_NSE': (1e-5, 0.02),
}

# --- INS with a Gauss-Markov bias -----------------------------------------------------------------


def _imunoise(parent: str, noise: FilterNoise) -> Iterator[Entry]:
    """Yield arw, vrw, gbstd, abstd and corrtime: the bias noise is 2 sigma^2 / corrtime."""
    yield from noise.keyed({'arw': ('gyro', 'N')}, 'deg/sqrt(h)', (parent,))
    yield from noise.keyed({'vrw': ('accel', 'N')}, 'm/s/sqrt(h)', (parent,))
    for key, sensor, unit in (('gbstd', 'gyro', 'deg/h'), ('abstd', 'accel', 'mGal')):
        bias = noise.process(sensor, common=True)
        values = [rounded(sigma / UNITS[unit].factor) for sigma in bias.sigma]
        value = values if noise.convention.three else values[0]
        yield Entry((parent, key), value, f'[{unit}]: {bias.words}', findings=bias.findings)
    words = '[h]: correlation time that suits all axes'
    yield Entry((parent, 'corrtime'), rounded(noise.common_tau / HOUR), words)


def _navego(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the fields of the struct of ins_gnss.m, in SI.

    The filter takes gb_psd and ab_psd for the density of the noise that drives the bias:
    sigma sqrt(2 / tau) of a Gauss-Markov process.
    """
    white = {'arw': ('gyro', 'N'), 'vrw': ('accel', 'N')}
    yield from noise.keyed(white)
    for prefix, sensor, unit in (('g', 'gyro', 'rad/s'), ('a', 'accel', 'm/s^2')):
        bias = noise.process(sensor)
        density = [rounded(s * math.sqrt(2.0 / t)) for s, t in zip(bias.sigma, bias.tau)]
        sigma = [rounded(s) for s in bias.sigma]
        yield Entry((f'{prefix}b_dyn',), sigma, f'[{unit}]: {bias.words}', findings=bias.findings)
        yield Entry((f'{prefix}b_corr',), [rounded(t) for t in bias.tau], '[s]')
        words = f'[{unit}/sqrt(Hz)] = sigma sqrt(2 / {prefix}b_corr)'
        yield Entry((f'{prefix}b_psd',), density, words)


# --- filters without such parameters --------------------------------------------------------------


def _fusioncore(noise: FilterNoise) -> Iterator[Entry]:
    """Yield R as a std per sample, and the bias variance that each step adds."""
    white = {'imu.gyro_noise': ('gyro', 'N'), 'imu.accel_noise': ('accel', 'N')}
    walk = {'ukf.q_gyro_bias': ('gyro', 'K'), 'ukf.q_accel_bias': ('accel', 'K')}
    yield from noise.keyed(white, 'std', ANY_NODE)
    yield from noise.keyed(walk, 'step_variance', ANY_NODE)


def _madgwick(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the gain, and zeta from the ramp if every axis has one, else from the random walk."""
    horizon = noise.horizons.high
    white = noise.level('gyro', 'N')
    gains = {
        axis: madgwick_gain(result.fit.selected, horizon)
        for axis, result in noise.axes_of('gyro').items()
    }
    mean = math.sqrt(sum(gain**2 for gain in gains.values()) / 3.0)
    gain = mean if noise.rule == 'mean' else max(gains.values())
    if not gain:  # N itself is a limit
        gain = math.sqrt(3.0 / 4.0 / horizon) * white.values[0] / noise.options.inflate
    words = f'[rad/s] = sqrt(3/4) times the Allan deviation at h = {horizon:g} s: '
    words += ', '.join(f'{axis} {value:.3g}' for axis, value in gains.items())
    entry = Entry((*ANY_NODE, 'gain'), rounded(gain * noise.options.inflate), words)
    yield clamped(entry, 0.0, 1.0)
    ramps = [result.fit.noise['R'] for result in noise.axes_of('gyro').values()]
    path = (*ANY_NODE, 'zeta')
    if all(ramp.status == 'estimated' for ramp in ramps):
        level, formula = noise.level('gyro', 'R'), 'sqrt(3/4) |R|'
        zeta = noise.entry(path, level, formula, 'rad/s^2', lambda r, _: madgwick_ramp_gain(r))
    else:
        level, formula = noise.level('gyro', 'K'), f'sqrt(3/4) K / sqrt(h) with h = {horizon:g} s'
        zeta = noise.entry(
            path, level, formula, 'rad/s^2', lambda k, _: madgwick_drift_gain(k, horizon)
        )
    yield clamped(zeta, -1.0, 1.0)


ESTIMATORS = {
    'kalibr': Target(
        'imu.yaml',
        Convention(
            'continuous time; Kalibr divides by sqrt(1/update_rate) itself and refuses values <= 0 '
            '(kalibr_common/ConfigReader.py)'
        ),
        _kalibr,
        YamlForm(),
    ),
    'openvins': Target(
        'kalibr_imu_chain.yaml',
        Convention(
            'continuous time; OpenVINS makes them discrete with its time steps '
            '(ov_msckf/src/state/Propagator.cpp)'
        ),
        _openvins,
        YamlForm(opencv=True),
        notes=(
            'T_i_b, time_offset, model, Tw, Ta, Tg and the rotations are not measured here: '
            'identity unless your file has them',
        ),
    ),
    'vins_fusion': Target(
        'vins_fusion_imu.yaml',
        Convention(
            'standard deviation per sample (vins_estimator/src/factor/integration_base.h)',
            exact=True,
        ),
        _vins_fusion,
        YamlForm(opencv=True),
    ),
    'orb_slam3': Target(
        'orb_slam3_imu.yaml',
        Convention(
            'continuous time; ORB-SLAM3 multiplies the noises by sqrt(IMU.Frequency) and divides '
            'the walks by it (src/Tracking.cc); it reads real numbers (src/Settings.cc)'
        ),
        table(
            keys('IMU.NoiseGyro', 'IMU.NoiseAcc', 'IMU.GyroWalk', 'IMU.AccWalk'),
            rate_key='IMU.Frequency',
        ),
        YamlForm(opencv=True),
    ),
    'lio_sam': Target(
        'lio_sam_imu.yaml',
        Convention(
            'continuous time, squared for GTSAM; the walks become the noise of the factor between '
            'two biases, times the root of the time between (src/imuPreintegration.cpp)'
        ),
        table(keys('imuGyrNoise', 'imuAccNoise', 'imuGyrBiasN', 'imuAccBiasN'), parent=ANY_NODE),
        YamlForm(),
    ),
    'fast_lio': Target(
        'fast_lio_imu.yaml',
        Convention(
            "variance per sample; the filter adds (dt F) Q (dt F)' (src/IMU_Processing.hpp, "
            'IKFoM_toolkit/esekfom/esekfom.hpp)'
        ),
        table(
            keys('gyr_cov', 'acc_cov', 'b_gyr_cov', 'b_acc_cov'), 'variance', (*ANY_NODE, 'mapping')
        ),
        YamlForm(),
        notes=(
            'the defaults of FAST-LIO (0.1 and 0.0001) are tuned and far above any noise at rest; '
            'approach them in steps with --inflate',
        ),
    ),
    'gtsam': Target(
        'gtsam_imu.py',
        Convention(
            'continuous covariances, divided or multiplied by the time step '
            '(gtsam/navigation/PreintegrationParams.h, CombinedImuFactor.cpp)',
            three=True,
        ),
        table(
            keys(
                'gyroscopeCovariance',
                'accelerometerCovariance',
                'biasOmegaCovariance',
                'biasAccCovariance',
            ),
            'covariance',
        ),
        PythonForm('{key} = {value}', before='\nimport numpy as np\n\n', after=GTSAM_CODE),
        notes=('the bias covariances are for PreintegrationCombinedParams only',),
    ),
    'basalt': Target(
        'basalt_imu.json',
        Convention(
            'continuous time; Basalt multiplies by sqrt(imu_update_rate) itself '
            '(basalt/calibration/calibration.hpp, dicrete_time_gyro_noise_std)',
            three=True,
        ),
        _basalt,
        JsonForm(),
        notes=('merge it into your calibration: the cameras are in the same file',),
    ),
    'msckf_vio': Target(
        'msckf_vio_imu.yaml',
        Convention("continuous time; Q = Phi G Qc G' Phi' dt (src/msckf_vio.cpp, processModel)"),
        table(keys('gyro', 'acc', 'gyro_bias', 'acc_bias'), parent=('noise',)),
        YamlForm(),
        notes=(
            'load it in the node: <rosparam command="load" file="..."/>, after its other noise',
        ),
    ),
    'fusioncore': Target(
        'fusioncore_imu.yaml',
        Convention(
            'R is the square of a standard deviation per sample (sensors/imu.hpp); q is the '
            'variance that each prediction adds, one per sample (src/ukf.cpp)',
            horizon_s=INS_HORIZON_S,
        ),
        _fusioncore,
        YamlForm(),
        notes=('q of angular velocity and acceleration is motion of the robot, not measured here',),
    ),
    'px4': Target(
        'px4_imu.params',
        Convention(
            'standard deviation per EKF2 step of 10 ms (src/modules/ekf2/EKF/covariance.cpp, '
            'EKF2_PREDICT_US)',
            rate_hz=100.0,
            horizon_s=INS_HORIZON_S,
        ),
        partial(_ranged, keys(*PX4_RANGES), PX4_RANGES),
        LineForm('1\t1\t{key}\t{value}\t9'),  # vehicle, component (the autopilot), 9: a real number
        notes=(FLOOR_NOTE,),
    ),
    'ardupilot': Target(
        'ardupilot_imu.parm',
        Convention(
            'standard deviation per EK3 step of 12 ms '
            '(libraries/AP_NavEKF3/AP_NavEKF3_core.cpp, EKF_TARGET_DT)',
            rate_hz=1.0 / 0.012,
            horizon_s=INS_HORIZON_S,
        ),
        partial(_ranged, keys(*ARDUPILOT_RANGES), ARDUPILOT_RANGES),
        LineForm('{key},{value}'),
        notes=(FLOOR_NOTE,),
    ),
    'kf_gins': Target(
        'kf_gins_imu.yaml',
        Convention(
            'continuous random walks; bias as a first-order Gauss-Markov process with the noise '
            '2 sigma^2 / corrtime (src/kf_gins.cpp, src/kf-gins/gi_engine.cpp)',
            three=True,
            horizon_s=INS_HORIZON_S,
            walk=False,
        ),
        partial(_imunoise, 'imunoise'),
        YamlForm(),
        notes=(
            'gbstd and abstd are also the initial uncertainty of the bias: set initbgstd and '
            'initbastd, because a turn-on bias is mostly larger',
            'gsstd and asstd (scale factors) are not measured here',
            'x, y, z are those of the messages; KF-GINS takes forward, right, down',
        ),
    ),
    'ob_gins': Target(
        'ob_gins_imu.yaml',
        Convention(
            'continuous random walks; bias as a first-order Gauss-Markov process with the noise '
            '2 sigma^2 / corrtime (src/ob_gins.cc, src/preintegration/preintegration_normal.cc)',
            horizon_s=INS_HORIZON_S,
            walk=False,
        ),
        partial(_imunoise, 'imumodel'),
        YamlForm(),
    ),
    'ic_gvins': Target(
        'ic_gvins_imu.yaml',
        Convention(
            'continuous random walks; bias as a first-order Gauss-Markov process with the noise '
            '2 sigma^2 / corrtime (config/gvins.yaml, the preintegration of OB_GINS)',
            horizon_s=INS_HORIZON_S,
            walk=False,
        ),
        partial(_imunoise, 'imumodel'),
        YamlForm(),
    ),
    'navego': Target(
        'navego_imu.m',
        Convention(
            'SI fields of the structure that ins_gnss.m takes: Q of arw, vrw, gb_psd, ab_psd '
            'squared, bias -1/corr (ins-gnss/ins_gnss.m, F_update.m)',
            three=True,
            horizon_s=INS_HORIZON_S,
            walk=False,
        ),
        _navego,
        MatlabForm('imu.{key} = {value};', comment='%'),
        notes=('run it after imu_si_errors.m, which computes gb_psd and ab_psd differently',),
    ),
    'imu_filter_madgwick': Target(
        'imu_filter_madgwick.yaml',
        Convention(
            "Madgwick's beta (rad/s) and zeta (rad/s^2): sqrt(3/4) times the error and the drift "
            'of the gyro (imu_filter_madgwick/src/imu_filter.cpp; ranges of imu_filter_ros.cpp)',
            horizon_s=10.0,
            walk=False,
        ),
        _madgwick,
        YamlForm(),
        notes=(
            'the gain allows for noise only: a bias at switching on that is not removed comes on '
            'top, and the default of 0.1 allows for one',
            'zeta acts with a magnetometer (use_mag) only; without one the filter estimates no '
            'bias',
        ),
    ),
}
"""Name -> target."""
