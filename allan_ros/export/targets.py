# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All export targets: title, keys, convention and format of each file.

Each convention was verified in the source file that it names. In formulas, N and K are
continuous-time noise densities, and f is the rate in Hz.
"""

from __future__ import annotations

import numpy as np

from .computed import (
    covariance_rows,
    gazebo_rows,
    madgwick_rows,
    state_space_rows,
    temperature_rows,
)
from .target import (
    ANY_NODE,
    INS_HORIZON_S,
    SIMULATOR_HORIZON_S,
    Key,
    Target,
    Value,
    json_form,
    keys_of,
    line_form,
    noise_keys,
    opencv_form,
    xml_form,
    yaml_form,
)

KALIBR_KEYS = keys_of("""
accelerometer_noise_density  accel  N
accelerometer_random_walk    accel  K
gyroscope_noise_density      gyro   N
gyroscope_random_walk        gyro   K
rostopic                     -      topic
update_rate                  -      rate
""")


OPENVINS_NOT_MEASURED: dict[str, Value] = {
    'T_i_b': np.eye(4).tolist(),
    'time_offset': 0.0,
    'model': 'kalibr',
    'Tw': np.eye(3).tolist(),
    'R_IMUtoGYRO': np.eye(3).tolist(),
    'Ta': np.eye(3).tolist(),
    'R_IMUtoACC': np.eye(3).tolist(),
    'Tg': [[0.0] * 3] * 3,
}
"""Keys that OpenVINS requires but that are not measured, with the values of an ideal IMU."""

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
        # Up to GTSAM 4.2 the default is the identity, far above any bias of an IMU. The uncertainty
        # of the initial bias belongs into the prior factor of the bias.
        params.setBiasAccOmegaInit(np.zeros((6, 6)))
    return params
'''

PYINS_CODE = '''

def models(gyro_bias_sd, accel_bias_sd):
    """Return the two arguments gyro_model and accel_model of the filters of pyins.

    The standard deviations of the initial biases in rad/s and m/s^2 are not measured here.
    """
    from pyins.inertial_sensor import EstimationModel

    return (
        EstimationModel(gyro_bias_sd, gyro_noise, gyro_bias_walk),
        EstimationModel(accel_bias_sd, accel_noise, accel_bias_walk),
    )
'''

FLOOR_NOTE = (
    'these numbers are the noise at rest, a lower limit: propellers, vibration and clipping add '
    'noise, which the defaults of the autopilot include; check the logs before you use numbers '
    'below the defaults'
)

TARGETS = {
    'kalibr': Target(
        'Kalibr imu.yaml: continuous densities N and K',
        'imu.yaml',
        'continuous time; Kalibr divides by sqrt(1/update_rate) itself and refuses values <= 0 '
        '(kalibr_common/ConfigReader.py)',
        yaml_form,
        KALIBR_KEYS,
    ),
    'openvins': Target(
        'OpenVINS kalibr_imu_chain.yaml: continuous densities N and K',
        'kalibr_imu_chain.yaml',
        'continuous time; OpenVINS makes N and K discrete with its time steps '
        '(ov_msckf/src/state/Propagator.cpp)',
        opencv_form,
        KALIBR_KEYS,
        parent=('imu0',),
        fixed=OPENVINS_NOT_MEASURED,
        notes=(
            'T_i_b, time_offset, model, Tw, Ta, Tg and the rotations are not measured here: keep '
            'the values of your file if it has them',
        ),
    ),
    # The midpoint rule averages two samples and treats their noise as independent. In a step dt, it
    # adds gyr_n^2 dt^2 / 2 to the variance of the angle, although white noise adds N^2 dt. The
    # customary gyr_n = N sqrt(f) thus propagates half of the variance; N sqrt(2f) would propagate
    # all of it. For the bias, each step adds gyr_w^2 dt^2. A random walk adds K^2 dt, so gyr_w is
    # K sqrt(f).
    'vins_fusion': Target(
        'VINS-Mono and VINS-Fusion: std per sample, N sqrt(f) and K sqrt(f)',
        'vins_fusion_imu.yaml',
        'standard deviation per sample (vins_estimator/src/factor/integration_base.h)',
        opencv_form,
        keys_of("""
        acc_n  accel  N  std
        gyr_n  gyro   N  std
        acc_w  accel  K  std
        gyr_w  gyro   K  std
        """),
        notes=(
            'acc_n and gyr_n are the usual N sqrt(f), of which the midpoint rule of this filter '
            'propagates half of the variance; sqrt(2) times these numbers propagate all of it',
        ),
    ),
    'orb_slam3': Target(
        'ORB-SLAM3 settings: continuous densities N and K, and the rate',
        'orb_slam3_imu.yaml',
        'continuous time; ORB-SLAM3 multiplies the noises by sqrt(IMU.Frequency) and divides the '
        'walks by sqrt(IMU.Frequency) (src/Tracking.cc); all numbers must be written as real '
        'numbers (src/Settings.cc)',
        opencv_form,
        (
            *noise_keys('IMU.NoiseGyro IMU.NoiseAcc IMU.GyroWalk IMU.AccWalk'),
            Key('IMU.Frequency', '-', 'rate'),
        ),
    ),
    'lio_sam': Target(
        'LIO-SAM ROS 2 parameters: continuous densities N and K',
        'lio_sam_imu.yaml',
        'continuous time, squared for GTSAM; the noise of the factor between two biases is the '
        'walk times the root of the time between them (src/imuPreintegration.cpp)',
        yaml_form,
        noise_keys('imuGyrNoise imuAccNoise imuGyrBiasN imuAccBiasN'),
        parent=ANY_NODE,
    ),
    'fast_lio': Target(
        'FAST-LIO and FAST-LIO2 ROS 2 parameters: variances N^2 f and K^2 f',
        'fast_lio_imu.yaml',
        "variance per sample; the filter adds (dt F) Q (dt F)' (src/IMU_Processing.hpp, "
        'IKFoM_toolkit/esekfom/esekfom.hpp)',
        yaml_form,
        noise_keys('gyr_cov acc_cov b_gyr_cov b_acc_cov', 'variance'),
        parent=(*ANY_NODE, 'mapping'),
        notes=(
            'the defaults of FAST-LIO (0.1 and 0.0001) are tuned and far above any noise at rest; '
            'if these numbers are too small, increase them towards the defaults with --inflate',
        ),
    ),
    'fast_livo2': Target(
        'FAST-LIVO2 parameters: variance N^2 f',
        'fast_livo2_imu.yaml',
        'variance per sample; the filter adds cov dt^2 (src/LIVMapper.cpp, src/IMU_Processing.cpp)',
        yaml_form,
        keys_of("""
        gyr_cov  gyro   N  variance
        acc_cov  accel  N  variance
        """),
        parent=('imu',),
        notes=(
            'the variance of the bias is fixed in the code to 1e-4, which is K = 0.01 / sqrt(f); '
            'b_acc_cov and b_gyr_cov are not read',
        ),
        walk=False,
    ),
    'point_lio': Target(
        'Point-LIO parameters: variances N^2 f and K^2 f',
        'point_lio_imu.yaml',
        'variance per sample: imu_meas_*_cov is R of the IMU as a measurement; *_input and b_*_cov '
        'are Q, multiplied by dt^2 (src/Estimator.cpp, '
        'include/IKFoM/IKFoM_toolkit/esekfom/esekfom.hpp)',
        yaml_form,
        (
            *keys_of("""
            imu_meas_omg_cov  gyro   N  variance
            imu_meas_acc_cov  accel  N  variance
            """),
            *noise_keys('gyr_cov_input acc_cov_input b_gyr_cov b_acc_cov', 'variance'),
        ),
        parent=('mapping',),
        notes=(
            'acc_cov_output and gyr_cov_output describe the motion of the robot, which is not '
            'measured here',
            'the defaults (0.1 and 0.0001) are tuned and far above any noise at rest',
        ),
    ),
    'glim': Target(
        'GLIM config_sensors.json: continuous density N, and K for the time between two scans',
        'glim_config_sensors.json',
        'continuous densities, squared for GTSAM (src/glim/common/imu_integration.cpp); '
        'imu_bias_noise is the standard deviation of the change of each bias between two scans '
        '(src/glim/odometry/odometry_estimation_imu.cpp)',
        json_form,
        keys_of("""
        imu_acc_noise   accel  N
        imu_gyro_noise  gyro   N
        imu_bias_noise  -      K  step_std
        """),
        parent=('sensors',),
        notes=(
            'f is the rate of the scans: give --filter-rate if it is not 10 Hz',
            'imu_bias_noise is one number for gyro and accelerometer: the larger one',
            'copy the numbers into your config_sensors.json, which also contains T_lidar_imu',
        ),
        rate_hz=10.0,
    ),
    'lvi_sam': Target(
        'LVI-SAM params_lidar.yaml: continuous densities N and K',
        'lvi_sam_imu.yaml',
        'continuous time, squared for GTSAM; the walks are multiplied by the root of the time '
        'between two biases (src/lidar_odometry/imuPreintegration.cpp)',
        yaml_form,
        noise_keys('imuGyrNoise imuAccNoise imuGyrBiasN imuAccBiasN'),
        parent=('lvi_sam',),
        notes=('params_camera.yaml has the convention of VINS: write it with --to vins_fusion',),
    ),
    'gtsam': Target(
        'GTSAM PreintegrationCombinedParams in Python: continuous covariances N^2 and K^2',
        'gtsam_imu.py',
        'continuous covariances, divided or multiplied by the time step '
        '(gtsam/navigation/PreintegrationParams.h, CombinedImuFactor.cpp)',
        line_form('{key} = {value}', before='\nimport numpy as np\n\n', after=GTSAM_CODE),
        noise_keys(
            'gyroscopeCovariance accelerometerCovariance biasOmegaCovariance biasAccCovariance',
            'covariance',
        ),
        notes=('the bias covariances are for PreintegrationCombinedParams only',),
        three=True,
    ),
    'basalt': Target(
        'Basalt calibration JSON: continuous densities N and K of each axis',
        'basalt_imu.json',
        'continuous time; Basalt multiplies by sqrt(imu_update_rate) itself '
        '(basalt/calibration/calibration.hpp, dicrete_time_gyro_noise_std)',
        json_form,
        keys_of("""
        imu_update_rate  -      rate
        accel_noise_std  accel  N
        gyro_noise_std   gyro   N
        accel_bias_std   accel  K
        gyro_bias_std    gyro   K
        """),
        parent=('value0',),
        notes=('copy the numbers into your calibration file, which also contains the cameras',),
        three=True,
    ),
    'msckf_vio': Target(
        'MSCKF_VIO parameters: continuous densities N and K',
        'msckf_vio_imu.yaml',
        "continuous time; Q = Phi G Qc G' Phi' dt (src/msckf_vio.cpp, processModel)",
        yaml_form,
        noise_keys('gyro acc gyro_bias acc_bias'),
        parent=('noise',),
        notes=(
            'load this file in the node, after its other noise parameters: '
            '<rosparam command="load" file="..."/>',
        ),
    ),
    # EKF2 and EK3 add (dt noise)^2 to the variance of angle and velocity, and (dt bias_noise)^2 to
    # the variance of the bias. dt is the step of the filter, over which the samples are averaged.
    'px4': Target(
        'PX4 EKF2 parameters: std per EKF step, within their ranges',
        'px4_imu.params',
        'standard deviation per EKF2 step of 10 ms (src/modules/ekf2/EKF/covariance.cpp, '
        'EKF2_PREDICT_US)',
        # columns: vehicle, component (1: the autopilot), key, value, type (9: a real number)
        line_form('1\t1\t{key}\t{value}\t9'),
        keys_of("""
        EKF2_GYR_NOISE    gyro   N  std  1e-4..0.1
        EKF2_ACC_NOISE    accel  N  std  0.01..1
        EKF2_GYR_B_NOISE  gyro   K  std  0..0.01
        EKF2_ACC_B_NOISE  accel  K  std  0..0.01
        """),
        notes=(FLOOR_NOTE,),
        rate_hz=100.0,
        horizon_s=INS_HORIZON_S,
    ),
    'ardupilot': Target(
        'ArduPilot EK3 parameters: std per EKF step, within their ranges',
        'ardupilot_imu.parm',
        'standard deviation per EK3 step of 12 ms '
        '(libraries/AP_NavEKF3/AP_NavEKF3_core.cpp, EKF_TARGET_DT)',
        line_form('{key},{value}'),
        keys_of("""
        EK3_GYRO_P_NSE   gyro   N  std  1e-4..0.1
        EK3_ACC_P_NSE    accel  N  std  0.01..1
        EK3_GBIAS_P_NSE  gyro   K  std  1e-5..1e-3
        EK3_ABIAS_P_NSE  accel  K  std  1e-5..0.02
        """),
        notes=(FLOOR_NOTE,),
        rate_hz=1.0 / 0.012,
        horizon_s=INS_HORIZON_S,
    ),
    'kf_gins': Target(
        'KF-GINS imunoise: deg/sqrt(hr), m/s/sqrt(hr) and a Gauss-Markov bias, of each axis',
        'kf_gins_imu.yaml',
        'continuous random walks; bias as a first-order Gauss-Markov process with the noise '
        '2 sigma^2 / corrtime (src/kf_gins.cpp, src/kf-gins/gi_engine.cpp)',
        yaml_form,
        keys_of("""
        arw       gyro   N           deg/sqrt(h)
        vrw       accel  N           m/s/sqrt(h)
        gbstd     gyro   sigma       deg/h
        abstd     accel  sigma       mGal
        corrtime  -      common_tau
        """),
        parent=('imunoise',),
        notes=(
            'gbstd and abstd are also the initial uncertainty of the bias: set initbgstd and '
            'initbastd, because a turn-on bias is usually larger',
            'gsstd and asstd (scale factors) are not measured here',
            'x, y, z are the axes of the messages; KF-GINS expects forward, right, down',
        ),
        three=True,
        horizon_s=INS_HORIZON_S,
        walk=False,
    ),
    'pyins': Target(
        'pyins EstimationModel in Python: continuous densities N and K of each axis',
        'pyins_imu.py',
        'continuous time: Q of noise and bias_walk squared, made discrete by van Loan '
        '(pyins/inertial_sensor.py, pyins/filters.py)',
        line_form('{key} = {value}', before='\n', after=PYINS_CODE),
        noise_keys('gyro_noise accel_noise gyro_bias_walk accel_bias_walk'),
        three=True,
        horizon_s=INS_HORIZON_S,
    ),
    'imu_filter_madgwick': Target(
        'imu_filter_madgwick ROS 2 parameters: gain and zeta at a horizon',
        'imu_filter_madgwick.yaml',
        "gain is Madgwick's beta (rad/s): sqrt(3/4) times the error of the gyro; zeta (rad/s^2): "
        'sqrt(3/4) times the drift of the gyro per second (imu_filter_madgwick/src/imu_filter.cpp; '
        'ranges of imu_filter_ros.cpp)',
        yaml_form,
        rows=madgwick_rows,
        notes=(
            'the gain covers noise, not the bias of the gyro: it must exceed 0.87 times the bias '
            'in rad/s unless the bias is subtracted before; the default of 0.1 covers 6 deg/s',
            'zeta has an effect only with a magnetometer (use_mag); without one, the filter '
            'estimates no bias',
        ),
        horizon_s=10.0,
        walk=False,
    ),
    'covariance': Target(
        'driver parameters: covariance matrices of sensor_msgs/Imu, 9 elements each',
        'imu_covariance.yaml',
        'covariance matrices of sensor_msgs/Imu, row by row: N^2 f of x, y, z on the diagonal',
        yaml_form,
        rows=covariance_rows,
        notes=(
            'for a driver with such parameters; robot_localization and fuse read the matrices from '
            'each Imu message',
            'the matrices contain white noise alone; for a filter without a state for the bias, '
            'the node allan_imu_relay also covers bias and drift (relay.horizon)',
        ),
        three=True,
        walk=False,
    ),
    'temperature': Target(
        'YAML: bias of each axis over temperature (b0, b1, b2) in SI and K',
        'temperature.yaml',
        'SI and K: the bias at T degC is b0 + b1 (T - reference) + b2 (T - reference)^2, and a '
        'filter subtracts it from the samples x, y, z',
        yaml_form,
        rows=temperature_rows,
        notes=(
            'the noise remains after the correction: export N and K to the file of the filter',
            'b0 is the mean of this recording; it contains the rotation of the Earth and differs '
            'after each switch-on; b0 of an accelerometer would contain gravity and is not written',
        ),
        three=True,
        walk=False,
    ),
    'state_space': Target(
        'JSON allan_ros/state_space/3: all processes, and Phi, Qd, R of each axis',
        'state_space.json',
        'exact discrete state space of the fitted processes (IEEE Std 952; van Loan 1978); '
        'Phi, Qd: a step of 1/rate_hz of (integral, walk, states of the processes); '
        'R = N^2 f: variance of a sample',
        json_form,
        rows=state_space_rows,
        notes=(
            'walk is a state even if it is 0: it represents the turn-on bias',
            'walk covers a ramp and slow sinusoids over the horizon, because they have no states; '
            'if K is not resolved, walk contains the estimate of K, or the upper limit of K if the '
            'model has no other drift',
        ),
        three=True,
        horizon_s=INS_HORIZON_S,
        walk=False,
    ),
    'gazebo': Target(
        'Gazebo SDF <imu>: std per sample and a Gauss-Markov bias, of each axis',
        'gazebo_imu.sdf',
        'standard deviation per sample, and a Gauss-Markov bias with the driving density '
        'dynamic_bias_stddev (gz-sensors, src/GaussianNoiseModel.cc)',
        xml_form,
        rows=gazebo_rows,
        notes=(
            'put this element into <sensor type="imu">; f must be the update_rate of this sensor',
            'bias_stddev (turn-on bias) needs results of several recordings; precision is written '
            'where rounding causes more than a tenth of the white noise',
        ),
        three=True,
        horizon_s=SIMULATOR_HORIZON_S,
        walk=False,
        bound=False,
    ),
}
"""Name -> target, in the order of `allan export --list`."""
