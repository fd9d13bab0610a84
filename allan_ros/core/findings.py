# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The catalogue of findings: the only place where one is worded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .errors import one_line

Severity = Literal['info', 'warning', 'error']


@dataclass(frozen=True)
class Wording:
    """The words of one kind of finding; ``message`` and ``remedy`` are `str.format` templates."""

    severity: Severity
    message: str
    remedy: str


CATALOGUE = {
    # --- the stream: what was dropped, repaired or refused on the way to the sums -----------------
    'stamps_unusable': Wording(
        'warning',
        'header stamps are {what}; record time is used instead',
        'let the driver fill header.stamp, or choose record time to say that this is meant',
    ),
    'stamps_from_rate': Wording(
        'warning',
        'header stamps are {what} and there is no record time; samples are taken to come evenly at '
        'the declared {rate:g} Hz',
        'let the driver fill header.stamp: lost samples cannot be seen without it',
    ),
    'stamps_missing': Wording(
        'error',
        'header stamps are {what} and there is no record time',
        'let the driver fill header.stamp, or declare the rate',
    ),
    'bursty_stamps': Wording(
        'info',
        'stamps come in bursts; samples are taken to be even at {rate:.4g} Hz',
        'a sample lost here and there cannot be seen; stamp in the driver, or in the sensor, to do '
        'so',
    ),
    'rate_differs': Wording(
        'warning',
        'the stamps say {measured:.5g} Hz, {declared:.5g} Hz was declared',
        'the stamps are believed; correct the declared rate, or the clock that stamps',
    ),
    'rate_changed': Wording(
        'warning',
        'the sample rate changed {times} times; the results are of the longest time at one rate',
        'record at one rate: the noise of a digital sensor depends on it',
    ),
    'frame_changed': Wording(
        'warning',
        'frame_id changed from "{before}" to "{after}" (change {times}); different IMUs are kept '
        'apart',
        'give each IMU a topic of its own; the results are of the one with the longest time',
    ),
    'sensor_absent': Wording(
        'info',
        'no {sensor} in these messages (covariance[0] is -1, or not a number)',
        'nothing to do if the IMU has none; else let the driver fill it in',
    ),
    'sensor_all_zero': Wording(
        'info',
        'the {sensor} is zero throughout and is taken to be absent',
        'set its covariance[0] to -1 in the driver, as the message asks for',
    ),
    'zero_filled': Wording(
        'warning',
        '{share:.0%} of the messages have zeros for the {sensor}; only its own samples are used, '
        'at their own rate',
        'let the driver publish each sensor with its own samples, or set covariance[0] to -1 in '
        'the other half',
    ),
    'held': Wording(
        'warning',
        '{share:.0%} of the messages repeat the {sensor} sample before; only fresh samples are '
        'used, at their own rate',
        'nothing to do; a filter that takes all of them counts one sample several times',
    ),
    'gaps': Wording(
        'info',
        'samples are missing: {lost} lost in all, {cuts} gaps cut the recording into segments',
        'if it should have none, look at the queue depth of the recorder and the load of the '
        'machine',
    ),
    'bridged': Wording(
        'warning',
        '{bridged} lost samples ({share:.2%}) were interpolated, which raises N by up to '
        '{bias:.2%}',
        'use a deeper queue, or a reliable publisher, while recording',
    ),
    'not_finite': Wording(
        'warning',
        '{count} samples are NaN or infinite and were dropped',
        'look at the driver: a sensor does not measure infinity',
    ),
    'duplicates': Wording(
        'warning',
        '{count} samples repeat the one before, stamp and all, and were dropped',
        'look for two recorders or two publishers on one topic',
    ),
    'backward_stamps': Wording(
        'warning',
        '{count} samples are stamped before the latest one and were dropped',
        'look for two publishers on one topic, or a driver that stamps out of order',
    ),
    'clock_jumps': Wording(
        'warning',
        'the clock was set back {count} times; no difference straddles such a step',
        'stamp with a steady clock, or let the clock settle before recording',
    ),
    'motion': Wording(
        'info',
        'the IMU moved for {share:.1%} of the time; only the still rest counts',
        'let it rest for longer, or turn the motion gate off if it did rest',
    ),
    'never_still': Wording(
        'error',
        'the IMU was never found still in {seconds:.0f} s',
        'let it rest on a firm support; turn the motion gate off if it did rest',
    ),
    'relearned': Wording(
        'warning',
        'the recording began in motion: what was gathered until the IMU came to rest was thrown '
        'away',
        'begin with the IMU at rest',
    ),
    'stuck': Wording(
        'warning',
        'an axis showed one value for {count} samples, which noise does not do; they were dropped',
        'look at the sensor and its cable, and at the driver',
    ),
    'saturated': Wording(
        'warning',
        '{count} samples stand at the end of the range',
        'choose a wider range if the motion matters; a still IMU should never come near it',
    ),
    'no_noise': Wording(
        'error',
        'there is no noise to measure: the samples are constant or a straight line',
        'check that the sensor is powered and that its driver sends live values',
    ),
    'warm_up': Wording(
        'warning',
        'the mean drifts by {drift:.3g} {unit} in the first {seconds:.0f} s, far more than later',
        'leave out the warm-up: skip that long at the start',
    ),
    'short': Wording(
        'warning',
        'only {seconds:.3g} s of evidence',
        'record longer: minutes show N, hours show B and K',
    ),
    'nothing_left': Wording(
        'error',
        'no evidence is left of {received} samples',
        'the other findings say what became of them',
    ),
    # --- the nodes: what comes in, and what survives a restart ------------------------------------
    'no_publisher': Wording(
        'error',
        'nothing publishes on {topic}',
        'start the driver, or remap imu/data to its topic',
    ),
    'input_silent': Wording(
        'error',
        'no message on {topic} for {seconds:.1f} s, though {publishers} publish there',
        'look at the driver, its cable and its power, and at the network between',
    ),
    'input_stopped': Wording(
        'error',
        'the last message on {topic} came {seconds:.1f} s ago, and its publisher is gone',
        'start the driver again, and look at its log for why it ended',
    ),
    'input_unusable': Wording(
        'error',
        'messages come on {topic}, but none was usable for {seconds:.1f} s',
        'look at the values and stamps that the driver sends: the counts below say what is wrong',
    ),
    'qos_incompatible': Wording(
        'error',
        '{count} publishers on {topic} offer less than this subscription asks for; nothing comes '
        'from them',
        'leave its reliability at best_effort in the QoS overrides',
    ),
    'several_publishers': Wording(
        'warning',
        '{count} publishers on {topic}: {names}; their samples mix',
        'give each IMU a topic of its own; one that was killed is counted for some 20 s more',
    ),
    'messages_lost': Wording(
        'warning',
        '{lost} messages were lost on their way in the last minute, {share:.2%} of them',
        'raise input.queue_depth, or look at the load of the machine and the network',
    ),
    'samples_missing': Wording(
        'warning',
        '{count} samples of the last minute ({share:.2%}) were never sent, by the stamps of the '
        'others',
        'look at the driver, the bus of the sensor and the load of the machine that both are on',
    ),
    'stamps_leapt': Wording(
        'warning',
        'the stamps leapt ahead by {seconds:.0f} s within the last minute; no difference straddles '
        'it',
        'stamp with a steady clock, or let the clock settle before the driver starts',
    ),
    'frame_changed_lately': Wording(
        'warning',
        'frame_id changed {times} times in the last minute, now it is "{frame_id}"; each frame_id '
        'is taken to be an IMU of its own',
        'give each IMU a topic of its own; look at what the driver was started with, and where',
    ),
    'frame_waits': Wording(
        'warning',
        'the samples have frame_id "{present}" now, the results are of "{shown}", which has more '
        'evidence',
        'put that IMU back, or begin anew with ~/reset',
    ),
    'sensor_stuck': Wording(
        'warning',
        'an axis has been showing one value: {count} samples in the last minute',
        'look at the sensor and its cable, and at the driver',
    ),
    'rate_changed_lately': Wording(
        'warning',
        'the sample rate changed to {rate:.5g} Hz within the last minute; its sums are kept apart',
        'look at the settings of the driver: the noise of a digital sensor depends on its rate',
    ),
    'beyond_limit': Wording(
        'warning',
        '{term} is {value} ({interval}), above the {limit} of {reference} by more than '
        '{margin:.0%}',
        'look for vibration, a warm-up and the supply voltage; if it stays, the sensor is worse '
        'than it should be',
    ),
    'noise_changed': Wording(
        'warning',
        '{what} {verb} from {before} to {after} {ago} ago (ratio {low:.2f}..{high:.2f})',
        'look for vibration, a change of temperature or supply, or other settings of the sensor',
    ),
    'no_sums': Wording(
        'error',
        'no sums on {topic} for {seconds:.0f} s',
        'start allan_accumulator, or remap sums to its topic',
    ),
    'run_began_anew': Wording(
        'info',
        'the stamps went back and stayed back; the sums of the run before are {kept}',
        'nothing to do where a recording is looped: a second pass is no new evidence',
    ),
    'checkpoint_refused': Wording(
        'warning',
        '{path} is left as it is, and nothing is saved: {reason}',
        'give another checkpoint path, or move the file away',
    ),
    'checkpoint_in_use': Wording(
        'warning',
        '{path} is kept by another node ({owner}), and nothing is saved by this one',
        'stop one of the two, or give each a checkpoint of its own; then start this one again',
    ),
    'checkpoint_corrupt': Wording(
        'warning',
        '{path} is not whole and was renamed to {aside} ({reason})',
        'nothing to do: the sums began anew; look at the disk if it happens again',
    ),
    'checkpoint_unwritable': Wording(
        'warning',
        'the sums would not survive a restart: {reason}',
        'writing is tried again at every period',
    ),
    # --- the relay: what the messages passed on lack ----------------------------------------------
    'relay_without_model': Wording(
        'warning',
        'there is no noise model on {topic} yet: messages are {done}',
        'start allan_estimator, or remap noise_model to its topic; a minute at rest shows N',
    ),
    'relay_model_unreadable': Wording(
        'warning',
        'a noise model on {topic} cannot be read: {reason}',
        'let allan_estimator or allan_monitor of this version publish it',
    ),
    'relay_nothing_to_fill': Wording(
        'warning',
        'the noise model knows no variance of the {sensor}, whose covariance stays as it is',
        'let the IMU rest for longer, and fit by method gls',
    ),
    'relay_other_frame': Wording(
        'warning',
        '{count} messages have frame_id "{found}", the noise model is of "{expected}"; they were '
        'passed on as they are',
        'relay the topic that is measured; axes that were turned have other variances',
    ),
    'relay_malformed': Wording(
        'warning',
        '{count} messages are no Imu and were passed on as they are; the last: {reason}',
        'look at what publishes on {topic}',
    ),
    'relay_unpublished': Wording(
        'warning',
        '{count} messages could not be published',
        'look for a reliable subscriber that has stopped reading',
    ),
    # --- the recording: what the readers could not read to the end --------------------------------
    'table_cut': Wording(
        'warning',
        '{path}: line {line}, the last, is cut off and left out',
        'nothing to do unless more is missing; compare with the original',
    ),
    'bag_cut': Wording(
        'warning',
        '{path}: is cut off after {read} of {size} bytes (the recorder was not stopped cleanly); '
        'what is whole was read',
        'stop the recorder with Ctrl-C and wait for it to end; "mcap recover" mends the file '
        'itself',
    ),
    'recording_lost': Wording(
        'error',
        '{path}: is left out, because every worker of the cluster that read it died',
        'look into the logs of the workers (memory is the usual cause) and analyse it alone; '
        '"allan merge" adds it',
    ),
    # --- the fit: methods 'paper' and 'relative' --------------------------------------------------
    'too_few_points': Wording(
        'warning',
        'the curve has {points} points, five terms need at least {needed}',
        'record longer: an hour or more shows most terms',
    ),
    'negative_coefficient': Wording(
        'warning',
        'plain least squares makes {terms} negative, which no noise can be: the scatter of the '
        'long averaging times outweighs that term',
        'use the default method gls, which keeps terms from going below zero and gives limits',
    ),
    'overlap_gain': Wording(
        'info',
        'the same fit on overlapping groups gives {values}; its standard errors are {gains} times '
        'smaller',
        'method gls uses the overlapping groups and how they are correlated',
    ),
    # --- the fit: method 'gls' --------------------------------------------------------------------
    'record_too_short': Wording(
        'warning',
        'the longest segment has {samples} samples: too few to tell the terms apart',
        'record at least a minute at rest; an hour or more shows most terms',
    ),
    'low_pass': Wording(
        'info',
        'the samples are low-pass filtered (Q would be negative by {deviations:.0f} standard '
        'deviations), so Q is not observable',
        "switch the sensor's filter off to see Q; N is the noise of the frequencies that pass",
    ),
    'short_averages': Wording(
        'warning',
        'averaging times below {tau:.3g} s do not follow the five terms{hint} and were left out; Q '
        'is not observable',
        'look for a filter in the sensor, or vibration; N holds from that time on',
    ),
    'vibration': Wording(
        'warning',
        'the curve has the bump of a line at {frequency:.3g} Hz, amplitude {amplitude:.2g} {unit}; '
        'it was fitted beside the five terms, whose intervals allow for it',
        'look for a fan, a machine or a resonance of the building at this frequency, and put the '
        'sensor on a heavier or softer base',
    ),
    'gauss_markov': Wording(
        'info',
        'correlated noise of {sigma:.2g} {unit} with a correlation time of {time} was fitted '
        'beside the five terms, whose intervals allow for it',
        'a filter with a first-order Gauss-Markov bias takes these two numbers',
    ),
    'misfit': Wording(
        'warning',
        'the terms describe the curve to {misfit:.1%} only; the intervals are widened accordingly',
        'look at the curve: temperature, vibration or motion; record at rest, warmed up, in still '
        'air',
    ),
    'levels_off': Wording(
        'info',
        'the longest averages lie far below what the shorter ones foretell: the drift levels off',
        'K holds for times up to where the curve bends; a bias that returns is a first-order '
        'Gauss-Markov process, often of temperature',
    ),
    'rounding': Wording(
        'info',
        'the samples are multiples of {step:.3g} {unit}; rounding makes {share:.0%} of the white '
        'noise',
        'N includes it; a finer range or resolution of the sensor would lower it (it is not Q)',
    ),
    'drift_not_separable': Wording(
        'info',
        'there is drift, but this record cannot tell a random walk (K) from a ramp (R)',
        'record longer, {how_long}, at a steady temperature',
    ),
    'ramps_differ': Wording(
        'info',
        'the segments drift by different ramps, which noise does not explain; R is that of the '
        'longest',
        'let the sensor warm up and keep its temperature steady if R is wanted',
    ),
    'record_longer': Wording(
        'info',
        'this record is too short to show {terms}',
        'record {how_long}',
    ),
    # --- the files: what could not be made of the results -----------------------------------------
    'file_left_out': Wording(
        'warning',
        '{file} is not written ({why})',
        'the other files are complete',
    ),
    # --- the files for filters: what a number in them is not --------------------------------------
    'export_limits': Wording(
        'info',
        'not measured but the 95 % upper limit, because this record does not show it: {keys}',
        'record longer, or refuse such numbers with --strict',
    ),
    'export_clamped': Wording(
        'warning',
        '{key} would be {value:g}, outside the range {low:g} to {high:g} that is accepted; '
        '{written:g} is written',
        'nothing to do if the IMU is that good; else check unit and rate',
    ),
    'export_half_of_noise': Wording(
        'info',
        '{keys} are the customary N sqrt(f), of which the midpoint rule of this filter propagates '
        'half the variance',
        'write N sqrt(2f) with --exact, or allow for it in --inflate',
    ),
    'export_no_gauss_markov': Wording(
        'info',
        '{key} is B: no correlation time was found, so that corrtime is not measured for it',
        'tune corrtime, or record until the curve bends down behind its flat part',
    ),
}
"""id -> its words."""


__all__ = ['CATALOGUE', 'Finding', 'Severity', 'finding']


@dataclass(frozen=True)
class Finding:
    """One thing a user should know, and what to do about it."""

    id: str
    severity: Severity
    message: str
    remedy: str
    axes: tuple[str, ...] = ()

    def __str__(self) -> str:
        where = f'{", ".join(self.axes)}: ' if self.axes else ''
        return f'{where}{self.message}; {self.remedy}'


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding of that id with its numbers filled in.

    Raises
    ------
    KeyError
        When the id is not in the catalogue, or a value its words need is missing.
    """
    words = CATALOGUE[id]
    message, remedy = (one_line(t.format(**values)) for t in (words.message, words.remedy))
    return Finding(id, words.severity, message, remedy, axes)
