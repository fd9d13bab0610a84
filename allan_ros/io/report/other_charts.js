// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// The noise density, raw signal and temperature of one sensor, and its bias and noise over time.
'use strict';

const OtherCharts = (() => {
  const { color, element, number } = Chart;

  function spectrum(host, sensor, units) {
    const { frequency, axes } = sensor.spectrum;
    let system = units;
    const shown = new Set(axes.map((a) => a.name));
    const label = (a) => a.name.split('_').pop();
    const unit = () => sensor.units[system].density;
    const scaled = (values) => values.map((v) => (v === null ? null : v * unit()[1]));
    const columns = () => [frequency, ...axes.flatMap((a) => [scaled(a.density), scaled(a.fit)])];
    const series = axes.flatMap((a) => [
      { label: label(a), stroke: () => color(label(a)), width: 1.3, points: { show: false } },
      { label: `${label(a)} model`, stroke: () => color(label(a)), width: 1.6, dash: [7, 4], points: { show: false } },
    ]);
    const heading = element('h3', {}, 'Noise density');
    const axisName = () => `noise density [${unit()[0]}]`;
    const rangeY = () => {
      const values = axes.flatMap((a) => scaled(a.density)).filter((v) => v > 0);
      return [0.6 * Math.min(...values), 1.6 * Math.max(...values)];
    };
    function describe(u, at) {
      const [name, factor] = unit();
      return [
        [`${number(frequency[at])} Hz`, null],
        ...axes.filter((a) => shown.has(a.name) && a.density[at] > 0).map((a) => [
          `${label(a)}  ${number(a.density[at] * factor)} ${name}  (${number(a.low[at] * factor, 3)}..${number(a.high[at] * factor, 3)})`,
          color(label(a)),
        ]),
      ];
    }
    const controls = element('div', { class: 'controls' });
    host.append(heading, controls);
    const u = Chart.create(host, {
      label: `Noise density of the ${sensor.sensor}; arrow keys move from point to point`,
      height: 322,
      zoomY: true,
      x: { log: true, full: () => [frequency[0] / 1.2, frequency[frequency.length - 1] * 1.2], label: 'frequency [Hz]' },
      y: { log: true, full: rangeY, label: axisName() },
      series, describe,
    }, columns());
    controls.append(Chart.toggles('axes', axes.map((a) => ({ key: a.name, text: label(a), style: `var(--${label(a)})` })), (key, on) => {
      if (on) shown.add(key);
      else shown.delete(key);
      axes.forEach((a, i) => [1, 2].forEach((j) => u.setSeries(2 * i + j, { show: shown.has(a.name) })));
    }));
    host.append(element('p', { class: 'note' },
      'Root of the one-sided power spectral density (Welch 1967); dashed: the selected model. '
      + 'Its flat part is √2 N, the noise density of datasheets.'));
    heading.append(element('span', { class: 'grow' }), Picture.buttons(u, () => `${sensor.title}: noise density`, `density_${sensor.sensor}`));
    u.title = `${sensor.title}: noise density`;
    return { units(next) { system = next; u.axes[1].label = axisName(); u.setData(columns()); } };
  }

  const WHY = { motion: 'left out: the IMU moved', stuck: 'left out: an axis showed one value', '': 'left out' };
  const HATCHES = { motion: 'moved', stuck: 'bad', '': 'left-out' };

  // Slanting lines: rising to the right where the IMU moved, falling for any other reason.
  function hatch(context, from, to, top, height, why) {
    const ratio = devicePixelRatio;
    context.save();
    context.beginPath();
    context.rect(from, top, Math.max(to - from, 2 * ratio), height);
    context.clip();
    for (const [veil, ink] of [[0.75, 'paper'], [0.15, HATCHES[why]]]) {
      context.globalAlpha = veil;
      context.fillStyle = color(ink);
      context.fillRect(from, top, Math.max(to - from, 2 * ratio), height);
    }
    context.globalAlpha = 1;
    context.strokeStyle = color(HATCHES[why]);
    context.lineWidth = ratio;
    for (let x = from - height; x < to + ratio; x += 7 * ratio) {
      context.beginPath();
      context.moveTo(x, why === 'motion' ? top + height : top);
      context.lineTo(x + height, why === 'motion' ? top : top + height);
      context.stroke();
    }
    context.restore();
  }

  // Time in the unit of the chart: seconds, minutes or hours.
  function clock(seconds) {
    const length = seconds[seconds.length - 1];
    if (length > 7200) return [3600, 'h'];
    return length > 180 ? [60, 'min'] : [1, 's'];
  }

  function signal(host, sensor, units, temperatures) {
    const { time, axes, leftOut, gaps, starts } = sensor.signal;
    let system = units;
    const [scale, name] = clock(time);
    const shownTime = time.map((t) => t / scale);
    const excluded = (i) => leftOut.find(([from, to]) => time[i] < to && (i + 1 < time.length ? time[i + 1] : Infinity) > from);
    const made = [];
    const fold = element('details', { class: 'fold' }, element('summary', {}, 'Raw signal'));
    host.append(fold);
    const inner = element('div', {});
    fold.append(inner);
    axes.forEach((a, row) => {
      const label = a.name.split('_').pop();
      const last = row === axes.length - 1;
      const unit = () => sensor.units[system].signal;
      const columns = () => [shownTime, a.low, a.high].map((c, i) => (i ? c.map((v) => (v === null ? null : v * unit()[1])) : c));
      const heading = element('p', { class: 'row' });
      const showMiddle = () => { heading.textContent = `${label} about ${number(a.middle * unit()[1])} ${unit()[0]}`; };
      inner.append(heading);
      const u = Chart.create(inner, {
        label: `Raw signal of ${a.name}`,
        height: last ? 140 : 118,
        sync: 'signal',
        padding: [4, 14, 0, 0],
        x: { axis: { size: 26 }, label: last ? `time [${name}]` : '' },
        // The used samples fill the picture; an excluded knock may exceed it.
        y: { full: () => [-1.15 * a.reach * unit()[1], 1.15 * a.reach * unit()[1]], axis: { space: 24 } },
        series: [
          { label: 'low', stroke: () => color(label), width: 0.6, points: { show: false } },
          { label: 'high', stroke: () => color(label), width: 0.6, points: { show: false } },
        ],
        bands: [{ series: [2, 1], fill: () => color(label) }],
        above(chart) {
          const { ctx, bbox } = chart;
          const at = (t) => Math.min(Math.max(chart.valToPos(t / scale, 'x', true), bbox.left), bbox.left + bbox.width);
          for (const [from, to] of gaps) {  // over the line that joins its two sides
            ctx.fillStyle = color('gap');
            ctx.fillRect(at(from), bbox.top, Math.max(at(to) - at(from), devicePixelRatio), bbox.height);
          }
          ctx.fillStyle = color('ink-2');
          for (const start of starts.slice(1)) ctx.fillRect(at(start), bbox.top, devicePixelRatio, bbox.height);
          for (const [from, to, why] of leftOut) hatch(ctx, at(from), at(to), bbox.top, bbox.height, why);
        },
        describe(chart, i) {
          const [what, factor] = unit();
          const out = excluded(i);
          const celsius = temperatures ? nearest(temperatures, time[i]) : null;
          return [
            [`${number(shownTime[i])} ${name}`, null],
            [`${label}  ${number(a.low[i] * factor, 3)}..${number(a.high[i] * factor, 3)} ${what}`, color(label)],
            ...(celsius === null ? [] : [[`${number(celsius, 3)} °C`, null]]),
            ...(out ? [[WHY[out[2]], null]] : []),
          ];
        },
      }, columns());
      showMiddle();
      made.push((next) => { system = next; showMiddle(); u.setData(columns()); });
    });
    const note = ['Lowest and highest sample of each short interval.'];
    const reasons = new Set(leftOut.map(([, , why]) => why));
    if (reasons.has('motion')) note.push('Hatched to the upper right: left out because the IMU moved.');
    if (reasons.has('stuck')) note.push('Hatched to the lower right, red: left out because an axis repeated one value.');
    if (reasons.has('')) note.push('Hatched to the lower right, gray: left out (warm-up, or another rate).');
    if (gaps.length) note.push('Gray: no samples.');
    if (starts.length > 1) note.push('Vertical lines: start of the next recording.');
    inner.append(element('p', { class: 'note' }, note.join(' ')));
    return { units(next) { made.forEach((update) => update(next)); } };
  }

  // The reading nearest to a time.
  function nearest({ time, celsius }, at) {
    let best = null;
    let distance = Infinity;
    time.forEach((t, i) => {
      if (celsius[i] !== null && Math.abs(t - at) < distance) [best, distance] = [celsius[i], Math.abs(t - at)];
    });
    return best;
  }

  function temperature(host, temperatures, end) {
    const [scale, name] = clock([end]);
    const known = temperatures.celsius.filter((v) => v !== null);
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const room = Math.max(0.08 * (high - low), 0.2);
    const shownTime = temperatures.time.map((t) => t / scale);
    const heading = element('h3', {}, `Temperature: ${number(low, 3)} to ${number(high, 3)} °C`);
    host.append(heading);
    const u = Chart.create(host, {
      label: 'Temperature; arrow keys move from point to point',
      height: 150,
      sync: 'signal',
      padding: [4, 14, 0, 0],
      x: { axis: { size: 26 }, label: `time [${name}]`, full: () => [0, end / scale] },
      y: { full: () => [low - room, high + room], axis: { space: 24 } },
      series: [{ label: 'temperature', stroke: () => color('ink'), width: 1.3, points: { show: false } }],
      describe: (chart, i) => [[`${number(shownTime[i])} ${name}`, null], [`${number(temperatures.celsius[i])} °C`, null]],
    }, [shownTime, temperatures.celsius]);
    heading.append(element('span', { class: 'grow' }), Picture.buttons(u, () => 'Temperature', 'temperature'));
    host.append(element('p', { class: 'note' }, `From ${temperatures.source}. It does not affect the results; a bias often follows it.`));
  }

  const TRENDS = {
    bias: ['Bias over time', 'bias'],
    temperature: ['Bias against temperature', 'bias'],
    noise: ['Noise over time', 'deviation'],
  };

  // The bias or the noise of all axes over time, or over temperature as single points.
  function trend(host, sensor, units, data) {
    const [title, what] = TRENDS[data.kind];
    const points = data.kind === 'temperature';
    const [scale, name] = points ? [1, '°C'] : clock(data.x);
    const x = data.x.map((v) => v / scale);
    const label = (line) => line.name.split('_').pop();
    let system = units;
    const unit = () => sensor.units[system].curve;
    const columns = () => [x, ...data.lines.map(({ values }) => values.map((v) => (v === null ? null : v * unit()[1])))];
    const axisName = () => `${what} [${unit()[0]}]`;
    const caption = `${sensor.title}: ${title.toLowerCase()}`;
    function rangeY() {
      const known = columns().slice(1).flat().filter((v) => v !== null);
      const [low, high] = [Math.min(...known), Math.max(...known)];
      const room = 0.08 * (high - low) || 1e-9;
      return [data.kind === 'noise' ? 0 : low - room, high + room];
    }
    const listed = (values) => {
      const [of, factor] = unit();
      const known = data.lines.map((line, i) => [label(line), values[i]]).filter(([, v]) => v !== null);
      return `${known.map(([axis, v]) => `${axis} ${number(v * factor, 3)}`).join(', ')} ${of}`;
    };
    const notes = () => {
      if (data.kind === 'noise') return `Allan deviation at ${number(data.span, 2)} s in each period; it is constant if the noise does not change.`;
      const note = `Averages over ${number(data.span, 3)} s at rest, minus their mean.`;
      if (data.kind === 'temperature') return `${note} Slope of a straight line, per °C: ${listed(data.slopes)}.`;
      if (data.white.every((v) => v === null)) return note;
      return `${note} With white noise alone, 95 % of them would lie within ± ${listed(data.white)}.`;
    };
    const heading = element('h3', {}, title);
    host.append(heading);
    const u = Chart.create(host, {
      label: `${title} of the ${sensor.sensor}; arrow keys move from point to point`,
      height: 230,
      sync: points ? undefined : `trend-${sensor.sensor}`,
      x: { label: points ? 'temperature [°C]' : `time [${name}]` },
      y: { full: rangeY, label: axisName() },
      series: data.lines.map((line) => ({
        label: label(line), stroke: () => color(label(line)), width: points ? 0 : 1.3, dots: points, spanGaps: false,
        ...(points ? { paths: () => null, points: { show: true, size: 5, fill: () => color(label(line)) } } : { points: { show: false } }),
      })),
      describe: (chart, i) => [
        [`${number(x[i])} ${name}`, null],
        ...data.lines.filter((line) => line.values[i] !== null).map((line) => [`${label(line)}  ${number(line.values[i] * unit()[1])} ${unit()[0]}`, color(label(line))]),
      ],
    }, columns());
    heading.append(...data.lines.map((line) => element('span', { class: 'key', style: `color: var(--${label(line)})` }, label(line))));
    heading.append(element('span', { class: 'grow' }), Picture.buttons(u, () => caption, `${data.kind}_${sensor.sensor}`));
    const note = element('p', { class: 'note' }, notes());
    host.append(note);
    u.title = caption;
    return { units(next) { system = next; note.textContent = notes(); u.axes[1].label = axisName(); u.setData(columns()); } };
  }

  return { trend, spectrum, signal, temperature };
})();
