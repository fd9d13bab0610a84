# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The catalogue of findings, the only place where one is worded.

A message states the cause and the number, a remedy the next step; each is one short sentence.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from .errors import one_line

Severity = Literal['info', 'warning', 'error']

SEVERITIES: tuple[Severity, ...] = ('error', 'warning', 'info')
"""The most severe first."""


@dataclass(frozen=True)
class Wording:
    """The text of one kind of finding; ``message`` and ``remedy`` are `str.format` templates.

    ``{when}`` is empty for a complete stream and ' in the last minute' for a live one.
    """

    severity: Severity
    message: str
    remedy: str


_TEXT = """\
# the stream: samples dropped, repaired or rejected on the way to the sums
stamps_unusable: warning
  Header stamps are {what}, so record time is used.
  > Set header.stamp in the driver, or select record time to confirm.
stamps_from_rate: warning
  Header stamps are {what} and there is no record time; samples are placed evenly at the declared
  {rate:g} Hz.
  > Set header.stamp in the driver: lost samples cannot be detected without it.
stamps_missing: error
  Header stamps are {what} and there is no record time.
  > Set header.stamp in the driver, or declare the sample rate.
bursty_stamps: info
  Stamps arrive in bursts; samples are placed evenly at {rate:.4g} Hz.
  > Stamp samples in the sensor or driver if single lost samples must be detected.
rate_differs: warning
  The stamps give {measured:.5g} Hz, but {declared:.5g} Hz was declared; the stamps are used.
  > Correct the declared rate, or the clock that sets the stamps.
rate_changed: warning
  The sample rate changed {times} {times:time|times}{when} and is now {rate:.5g} Hz; the results
  come from the rate with the most data.
  > Keep the rate constant: the noise of a digital sensor depends on it.
frame_changed: warning
  frame_id changed {times} {times:time|times}{when} and is now "{frame_id}"; each frame_id counts as
  another IMU.
  > Give each IMU its own topic; the results are for the IMU with the most data.
sensor_absent: info
  The messages have no {sensor} data (covariance[0] is -1, or the values are NaN).
  > If the IMU has this sensor, publish its data in the driver.
sensor_all_zero: info
  All {sensor} values are zero; the sensor is treated as absent.
  > Set its covariance[0] to -1 in the driver if the IMU has no such sensor.
zero_filled: warning
  {share:.0%} of the messages have zeros for the {sensor}; only its own samples are used, at their
  own rate.
  > Publish each sensor with its own samples, or set covariance[0] to -1 in the others.
held: warning
  {share:.0%} of the messages repeat the previous {sensor} sample; only new samples are used, at
  their own rate.
  > No action is needed here, but a filter that uses every message counts samples twice.
gaps: info
  {lost} {lost:sample is|samples are} missing; {cuts} {cuts:gap splits|gaps split} the recording.
  > If this is unexpected, check the queue depth of the recorder and the load of the machine.
bridged: warning
  {bridged} lost {bridged:sample|samples} ({share:.2%}) {bridged:was|were} interpolated; N is
  corrected for it.
  > Record with a deeper queue or a reliable publisher.
not_finite: warning
  {count} {count:sample|samples}{when} {count:is|are} NaN or infinite and {count:was|were} dropped.
  > Check the driver.
duplicates: warning
  {count} {count:sample|samples}{when} {count:repeats|repeat} the previous stamp and values and
  {count:was|were} dropped.
  > Check for two recorders or two publishers on one topic.
backward_stamps: warning
  {count} {count:sample|samples}{when} {count:has|have} a stamp before the latest one and
  {count:was|were} dropped.
  > Check for two publishers on one topic, or a driver that stamps out of order.
clock_jumps: warning
  The clock was set back {count} {count:time|times}{when}; the data are split there.
  > Use a steady clock for the stamps, or let the clock settle first.
motion: info
  The IMU moved for {share:.1%} of the time; only data at rest are used.
  > If it was at rest, switch the motion gate off.
never_still: error
  The IMU was never at rest in {seconds:.0f} s.
  > Put it on a firm support, or switch the motion gate off if it was at rest.
relearned: warning
  The recording began in motion; data from before the IMU came to rest were discarded.
  > Start with the IMU at rest.
stuck: warning
  An axis repeated one value for {count} {count:sample|samples}{when}, which {count:was|were}
  dropped.
  > Check the sensor, its cable and the driver.
saturated: warning
  {count} {count:sample is|samples are} at the limit of the measurement range.
  > Select a wider range if the motion matters; an IMU at rest should not reach it.
spikes: info
  {count} isolated {count:spike|spikes} ({share:.3%} of the samples) {count:was|were} replaced by
  the mean of {count:its|their} neighbors.
  > Check the cable and the driver if there are many.
noise_louder: warning
  The noise rose to {ratio:.1f} times its floor for {seconds:.0f} s although the IMU was at rest;
  these data are excluded.
  > Check mounting, motors and supply; to measure this noise, switch the motion gate off.
gyro_unit: warning
  The gyro at rest has N = {n:.2g} rad/s/sqrt(Hz) and a mean of {rate:.2g} rad/s, which is
  implausible; the unit is probably deg/s.
  > Set the unit of the gyro to deg/s (--gyro-unit, or the parameter of the node).
accel_unit: warning
  The mean acceleration is {norm:.4g} m/s^2 instead of 9.8; the unit is probably {unit}.
  > Set the unit of the accelerometer to {unit} (--accel-unit, or the parameter of the node).
accel_scale: warning
  The mean acceleration is {norm:.4g} m/s^2 instead of 9.8 and fits no common unit.
  > Check the unit and the scale factor of the accelerometer.
no_noise: error
  The samples have no noise: they are constant or a straight line.
  > Check that the sensor is powered and that the driver sends live values.
short: warning
  There are only {seconds:.3g} s of data at rest.
  > Record minutes for N, hours for B and K.
nothing_left: error
  None of {received} {received:sample|samples} is usable.
  > See the other findings for the reasons.

# the nodes: input and checkpoint
no_publisher: error
  Nothing publishes on {topic}.
  > Start the driver, or remap imu/data to its topic.
input_silent: error
  No message on {topic} for {seconds:.1f} s, although {publishers} {publishers:publisher
  is|publishers are} connected.
  > Check the driver, the cable and power of the sensor, and the network.
wrong_type: error
  {topic} has type {types}, not sensor_msgs/msg/Imu.
  > Remap imu/data to an Imu topic{candidates}.
input_stopped: error
  The last message on {topic} came {seconds:.1f} s ago and its publisher is gone.
  > Restart the driver, and check its log for the reason.
input_unusable: error
  Messages arrive on {topic}, but none was usable for {seconds:.1f} s.
  > Check the values and stamps of the driver; the counts below name the problem.
qos_incompatible: error
  The QoS of {names} does not fit the subscription to {topic} ({reason}), so its messages do not
  arrive.
  > Remove the QoS overrides of {topic}: best_effort and volatile fit every publisher.
several_publishers: warning
  {count} publishers on {topic} ({names}): their samples are mixed.
  > Give each IMU its own topic; a killed publisher is listed for about 20 s more.
messages_lost: warning
  {lost} {lost:message|messages} ({share:.2%}) {lost:was|were} lost in transport in the last minute.
  > Raise input.queue_depth, or check the load of the machine and the network.
samples_missing: warning
  {count} {count:sample|samples} ({share:.2%}) of the last minute {count:was|were} never sent,
  according to the stamps.
  > Check the driver, the bus of the sensor and the load of the machine.
stamps_leapt: warning
  The stamps jumped ahead by {seconds:.0f} s in the last minute; the data are split there.
  > Use a steady clock for the stamps, or let the clock settle before the driver starts.
frame_waits: warning
  The samples now have frame_id "{present}", but the results are for "{shown}", which has more data.
  > Connect that IMU again, or call ~/reset.
beyond_limit: warning
  {term} is {value} ({interval}), above the {limit} of {reference} by more than {margin:.0%}.
  > Check vibration, warm-up and supply voltage; if the excess remains, the sensor is degraded.
noise_changed: warning
  {what} {verb} from {before} to {after} {ago} ago (ratio {low:.2f}..{high:.2f}).
  > Check vibration, temperature, supply voltage and the sensor settings.
no_sums: error
  No sums on {topic} for {seconds:.0f} s.
  > Start allan_accumulator, or remap sums to its topic.
run_began_anew: info
  The stamps went back and stayed there; the sums of the previous pass are {kept}.
  > No action is needed for a looped recording: a second pass adds no new data.
fit_failed: error
  The fit failed: {reason}.
  > If the next fit fails too, call ~/reset and report the log.
model_withdrawn: warning
  The coefficients were withdrawn: {lost:.0%} of their data were discarded or replaced.
  > Keep the IMU at rest; the next fit gives new ones.
internal_error: error
  Internal error in {where}: {error}.
  > Report it with the log; all other parts of the node continue.
checkpoint_refused: warning
  {path} is left unchanged and nothing is saved: {reason}.
  > Set another checkpoint path, or move the file away.
checkpoint_in_use: warning
  {path} is in use by another node ({owner}), so this node saves nothing.
  > Stop one of them, or give each its own checkpoint; then restart this node.
checkpoint_corrupt: warning
  {path} is damaged ({reason}); it was renamed to {aside} and the sums start from zero.
  > Check the disk if this happens again.
checkpoint_unwritable: warning
  The checkpoint cannot be written: {reason}.
  > Fix the path; until then the sums are lost at a restart. Writing is retried.

# the relay
relay_waits: info
  There is no noise model on {topic} yet; messages are {done}.
  > Keep the IMU at rest; N needs a minute.
relay_late_model: warning
  There was no noise model on {topic} for {seconds:.0f} s; messages are {done}.
  > Keep the IMU at rest; N needs a minute.
relay_without_model: warning
  Nothing publishes a noise model on {topic}; messages are {done}.
  > Start allan_estimator, or remap noise_model to its topic.
relay_withdrawn: warning
  The noise model on {topic} was withdrawn; messages are {done}.
  > Keep the IMU at rest; the next fit gives a new model.
relay_several_publishers: warning
  {count} publishers on {topic} ({names}): a filter receives their messages mixed.
  > Start each monitor in its own namespace, or remap the output of one.
relay_model_unreadable: warning
  A noise model on {topic} cannot be read: {reason}.
  > Publish it with allan_estimator or allan_monitor of this version.
relay_nothing_to_fill: warning
  The noise model has no variance of the {sensor}; its covariance is left unchanged.
  > Keep the IMU at rest for longer, and fit with method gls.
relay_other_frame: warning
  {count} {count:message has|messages have} frame_id "{found}", but the noise model is for
  "{expected}"; {count:it is|they are} passed on unchanged.
  > Relay the topic that is measured: rotated axes have other variances.
relay_malformed: warning
  {count} {count:message is not a valid Imu message and is|messages are not valid Imu messages and
  are} passed on unchanged; the last: {reason}.
  > Check the publisher of {topic}.
relay_unpublished: warning
  {count} {count:message|messages} could not be published.
  > Check for a reliable subscriber that stopped reading.

# the recording: unreadable parts
table_cut: warning
  {path}: the last line ({line}) has no line end and was dropped, because it may be truncated.
  > Compare with the original if more is missing.
bag_cut: warning
  {path}: {read} of {size} bytes could be read: the file is truncated or damaged.
  > Stop the recorder with Ctrl-C and wait for it to exit; "mcap recover" repairs the file.
count_differs: warning
  {path} states {stated} {stated:message|messages}, {read} {read:was|were} read.
  > Copy the recording again, or repair it with "mcap recover", "ros2 bag reindex" or "sqlite3 FILE
    .recover".
log_damaged: warning
  {path}: parts of the log are damaged and were skipped.
  > Copy the log again.
log_dropouts: info
  {path}: the logger dropped messages {count} {count:time|times}, {seconds:.3g} s in all.
  > Use a faster SD card, or log less.
log_decimated: warning
  {path}: {topic} is logged at {rate:.4g} Hz, but sampled at {full:.4g} Hz: N is too large.
  > Log every sample (SDLOG_PROFILE high rate).
covariance_ignored: warning
  {count} of {read} {read:message|messages} {count:declares|declare} the {sensor} as absent
  (covariance[0] is -1 or NaN), but {count:contains|contain} valid data, which were used.
  > Set the covariance in the driver, or drop the data with --trust-covariance.
unit_assumed: warning
  {path}: the header states no unit for the {sensor}; {unit} was assumed.
  > State the unit with --{sensor}-unit, or in the header, for example "{name} [{unit}]".
recording_lost: error
  {path} is left out, because every worker that read it died.
  > Check the logs of the workers (usually memory), analyze it alone, and use "allan merge".

# the fit: methods 'paper' and 'relative'
too_few_points: warning
  The curve has {points} {points:point|points}, but five terms need at least {needed}.
  > Record for an hour or more.
negative_coefficient: warning
  Plain least squares makes the square of {terms} negative, because the long averaging times scatter
  more than that term.
  > Use the default method gls, which gives an upper limit instead.
overlap_gain: info
  The same fit on overlapping groups gives {values} with standard errors {gains} times smaller.
  > Use the default method gls, which uses overlapping groups and their correlation.

# the fit: method 'gls'
record_too_short: warning
  The longest segment has {samples} {samples:sample|samples}, too few to separate the terms.
  > Record at least a minute at rest, and hours for B and K.
low_pass: info
  Low-pass filter detected. N is valid within its pass band; Q cannot be measured.
  > Switch the sensor's filter off to measure Q.
short_averages: warning
  Averaging times below {tau:.3g} s are excluded{hint}; Q cannot be measured.
  > Check for a filter in the sensor, or vibration.
vibration: warning
  Vibration at {frequency:.3g} Hz{alias}, amplitude {amplitude:.2g} {unit}; it is fitted as a
  separate term.
  > Isolate or move the sensor.
broad_hump: warning
  Resonance between {low:.2g} and {high:.2g} Hz, amplitude {amplitude:.2g} {unit}; it is fitted as
  several sinusoids.
  > Check the mounting, the table and the building for a resonance.
slow_disturbance: warning
  Periodic disturbance with a period of {period}, amplitude {amplitude:.2g} {unit}; it is fitted as
  a separate term.
  > Look for loads or interference with this period: swaying, switching supplies, polling.
slow_cycle: warning
  A cycle of {period}, amplitude {amplitude:.2g} {unit}, probably thermal; it is fitted as a
  separate term.
  > Keep the temperature steady: switch heating or air conditioning off.
gauss_markov: info
  Correlated noise of {sigma:.2g} {unit} with a correlation time of {time}; it is fitted as a
  separate term.
  > Use these two numbers in a filter with a first-order Gauss-Markov bias.
settled_part: info
  The first {early} differ from the rest ({what}) and are left out: {changes}.
  > Use --skip 0 for the coefficients of all data.
early_part: warning
  The first {early} differ from the rest ({what}): {changes}.
  > Skip them with --skip, or record longer after the warm-up.
warm_up: warning
  The sensor is warming up ({what}) and settles {settles}.
  > Record for at least {how_long} in total.
bias_steps: warning
  The bias has {count} or more steps of up to {size:.3g} {size_unit}: K is {before:.3g} {unit}
  with the steps, {after:.3g} without.
  > Look for switching heaters, loose connections or popcorn noise.
level_changes: warning
  The white noise differs {which}: N is {low:.4g} to {high:.4g} {unit}, {value:.4g} overall; the
  interval of N includes this scatter.
  > Look for vibration and changes of temperature.
drift_changes: info
  The size of the drift differs {which}, typically by {typical:.0%}; the intervals of B and K
  include this scatter.
  > Look for changes of temperature.
misfit: warning
  The model deviates from the data by up to {deviation:.0%} at tau = {tau}; the intervals are
  widened accordingly.
  > Check temperature, vibration and motion, and record at rest and warmed up.
levels_off: info
  The drift is bounded: K overestimates it beyond {tau}.
  > Use a first-order Gauss-Markov bias in the filter.
rounding: info
  The samples are multiples of {step:.3g} {unit}; rounding causes {share:.0%} of the white noise.
  > Select a finer range or resolution to lower N; rounding does not add to Q.
drift_not_separable: info
  There is drift, but random walk (K) and ramp (R) cannot be separated.
  > If either matters, record for longer, warmed up and at a steady temperature.
ramps_differ: info
  The segments drift at significantly different rates; R is the rate of the longest segment.
  > If R matters, let the sensor warm up and keep its temperature steady.
record_longer: info
  Not resolved: {terms}. The upper limit still matters to a filter within 100 s.
  > Record {how_long} at rest in one piece.

# the files
datasheets_differ: warning
  The runs were compared with different datasheets ({names}); their sum is compared with none.
  > Name the right one with --sensor.
file_left_out: warning
  {file} is not written ({why}).
  > All other files are complete.
export_limits: info
  Upper limits (95 %) instead of measured values: {keys}.
  > Record longer, or reject limits with --strict.
export_no_interval: info
  Values without a 95 % interval: {keys}.
  > Record longer and fit with method gls, or reject them with --strict.
export_clamped: warning
  {key} would be {value:g}, outside the accepted range {low:g} to {high:g}; {written:g} is written.
  > Check unit and rate.
export_half_of_noise: info
  {keys} are the customary N sqrt(f); the midpoint rule of this filter propagates only half of their
  variance.
  > Write N sqrt(2f) with --exact, or use --inflate.
export_no_gauss_markov: info
  No Gauss-Markov process was fitted; sigma and correlation time are chosen to match the error
  growth of the model over {horizons}.
  > Choose the range with --horizon, or use state_space for all processes.
export_two_numbers: warning
  N and K cannot describe this sensor: they overestimate the error growth by a factor of up to
  {ratio:.1f} over {horizons}.
  > Use a filter with Gauss-Markov states (state_space), or adjust --horizon.
"""
"""``id: severity``, the message, and after ``>`` the remedy, which may each have several lines.

``{count:sample is|samples are}`` is the first text where count is 1, else the second.
"""


def _parsed(text: str) -> Iterator[tuple[str, Wording]]:
    """Yield id and text of each kind of finding."""
    for entry in re.split(r'\n(?=\w)', re.sub(r'(?m)^(#.*)?\n', '', text)):
        head, _, words = entry.partition('\n')
        id, _, severity = head.partition(': ')
        message, _, remedy = (' '.join(part.split()) for part in words.partition('  > '))
        yield id, Wording(severity, message, remedy)  # type: ignore[arg-type]


CATALOGUE = dict(_parsed(_TEXT))
"""id -> its text."""


@dataclass(frozen=True)
class Finding:
    """A message to the user: the cause with its numbers, and the remedy."""

    id: str
    severity: Severity
    message: str
    remedy: str
    axes: tuple[str, ...] = ()

    def __str__(self) -> str:
        where = f'{", ".join(self.axes)}: ' if self.axes else ''
        return f'{where}{self.message} {self.remedy}'


PLURAL = re.compile(r'\{(\w+):([^{}|]*)\|([^{}|]*)\}')
"""A field of a template with the texts for one and for any other number."""


def _filled(template: str, values: Mapping[str, object]) -> str:
    """Return a template in one line with its numbers, and its words in singular or plural."""
    text = PLURAL.sub(lambda field: field[2 if values[field[1]] == 1 else 3], template)
    return one_line(text.format(**values))


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding ``id``, its numbers filled in; ``when`` may be left out.

    No axes means all of them.
    """
    wording = CATALOGUE[id]
    values = {'when': '', **values}
    message, remedy = (_filled(text, values) for text in (wording.message, wording.remedy))
    return Finding(id, wording.severity, message, remedy, axes)


def duration_text(seconds: float, digits: int = 2) -> str:
    """Return a duration in a suitable unit.

    >>> duration_text(90.0), duration_text(1234.0, digits=3), duration_text(86400.0 * 3.456)
    ('90 s', '20.6 min', '3.5 days')
    """
    for unit, size in (('days', 86400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2.0 * size:
            return f'{float(f"{seconds / size:.{digits}g}"):g} {unit}'
    return f'{float(f"{seconds:.{digits}g}"):g} s'
