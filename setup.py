# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All metadata of the package, for colcon and pip alike.

`pyproject.toml` holds no ``[project]`` table because colcon's ament_python build reads this file.
"""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'allan_ros'
DASK = 'distributed>=2022.2'
PLOTS = 'matplotlib>=3.5'
ULOG = 'pyulog>=1.0'
README = Path(__file__).resolve().with_name('README.md')
"""In the folder of the resolved path: `colcon build --symlink-install` runs a link to this file."""


def ros_wheels(distro):
    """Return the requirements that install rclpy and Fast DDS from PyPI, without ROS.

    The wheels exist for CPython 3.10 to 3.13 on x86-64 Linux only.
    """
    messages = (
        'diagnostic-msgs',
        'geometry-msgs',
        'rcl-interfaces',
        'rosgraph-msgs',
        'sensor-msgs',
        'std-msgs',
        'std-srvs',
    )
    return [f'ros-{distro}-rclpy[fastrtps]', *(f'ros-{distro}-{name}' for name in messages)]


setup(
    name=PACKAGE,
    version='1.1.0',
    description='Allan variance of IMUs on ROS 2: noise coefficients with 95 % intervals',
    author='the allan_ros authors',
    maintainer='the allan_ros authors',
    maintainer_email='maintainers@users.noreply.h-seed-d8235d04.example',
    long_description=README.read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    keywords=['Allan variance', 'IMU', 'noise', 'ROS 2', 'robotics'],
    classifiers=[
        'Environment :: Console',
        'Intended Audience :: Developers',
        'Intended Audience :: Science/Research',
        'Operating System :: OS Independent',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3.10',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Programming Language :: Python :: 3.14',
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    license='Apache-2.0',
    license_files=['LICENSE'],
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={
        PACKAGE: [
            'py.typed',
            'core/findings.txt',
            'view/findings.md',
            'view/report/*.css',
            'view/report/*.js',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/launch', glob('launch/*.launch.py')),
        (f'share/{PACKAGE}/config', glob('config/*.yaml')),
        (f'share/{PACKAGE}/config/fastdds', glob('config/fastdds/*')),
        (f'share/{PACKAGE}/config/filters', glob('config/filters/*.yaml')),
        (f'share/{PACKAGE}/config/sensors', glob('config/sensors/*.yaml')),
        (f'share/{PACKAGE}/config/viewers', glob('config/viewers/*')),
    ],
    python_requires='>=3.10',
    install_requires=[
        'numpy>=1.21',
        'PyYAML>=5.4',
        'rich>=10',  # tables of allan_watch; plain text without it
        'lz4>=3.1',  # mcap bags with this compression
        'rosbags>=0.11.7',  # writes bags; reads ROS 1 bags
        'scipy>=1.8',
        'zstandard>=0.18',  # mcap and sqlite3 bags with this compression
    ],
    extras_require={
        'audit': ['pip-audit>=2.7'],
        'dask': [DASK],
        'jazzy': ros_wheels('jazzy'),
        'kilted': ros_wheels('kilted'),
        'plots': [PLOTS],  # figures as files; the report draws its own charts
        'ulog': [ULOG],  # PX4 logs
        # For tests: filter libraries that read the exported files. gtsam 4.2 requires numpy 1, and
        # newer versions do not support Python 3.10.
        'consumers': [
            'gtsam>=4.3; python_version >= "3.11" and python_version < "3.14"',
            'opencv-python-headless>=4.5',
        ],
        'test': [
            'allantools==2024.6',
            'hypothesis>=6.100',
            'ipykernel>=6',
            'nbclient>=0.6',
            'pandas>=1.3',
            'pytest>=7',
            'pytest-xdist>=3',
            DASK,
            PLOTS,
            ULOG,
        ],
    },
    zip_safe=True,
    entry_points={
        'console_scripts': [
            f'allan = {PACKAGE}.cli.main:console',
            f'allan_accumulator = {PACKAGE}.nodes.__main__:accumulator',
            f'allan_estimator = {PACKAGE}.nodes.__main__:estimator',
            f'allan_imu_relay = {PACKAGE}.nodes.__main__:relay',
            f'allan_monitor = {PACKAGE}.nodes.__main__:monitor',
            f'allan_watch = {PACKAGE}.nodes.__main__:watch',
        ],
        'ros2cli.command': [f'allan = {PACKAGE}.ros2_command:AllanCommand'],
    },
)
