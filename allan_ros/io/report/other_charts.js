// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// The spectrum of one sensor with that of its fit, and its raw signal with what was left out.
'use strict';

const OtherCharts = (() => {
  const { colour, element, number } = Chart;

  function spectrum(host, sensor, units) {
    const { frequency, axes } = sensor.spectrum;
    let system = units;
    const shown = new Set(axes.map((a) => a.name));
    const label = (a) => a.name.split('_').pop();
    const unit = () => sensor.units[system].density;
    const scaled = (values) => values.map((v) => (v === null ? null : v * unit()[1]));
    const columns = () => [frequency, ...axes.flatMap((a) => [scaled(a.density), scaled(a.fit)])];
    const series = axes.flatMap((a) => [
      { label: label(a), stroke: () => colour(label(a)), width: 1.3, points: { show: false } },
      { label: `${label(a)} fit`, stroke: () => colour(label(a)), width: 1.6, dash: [7, 4], points: { show: false } },
    ]);
    const heading = element('h3', {});
    const tell = () => { heading.textContent = `Noise density, ${unit()[0]}`; };
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
          colour(label(a)),
        ]),
      ];
    }
    const controls = element('div', { class: 'controls' });
    host.append(heading, controls);
    const u = Chart.create(host, {
      label: `Noise density of the ${sensor.sensor}; arrow keys move from point to point`,
      height: 300,
      zoomY: true,
      x: { log: true, range: () => [frequency[0] / 1.2, frequency[frequency.length - 1] * 1.2] },
      y: { log: true, range: rangeY },
      series, describe,
    }, columns());
    controls.append(Chart.toggles('axes', axes.map((a) => ({ key: a.name, text: label(a), style: `var(--${label(a)})` })), (key, on) => {
      if (on) shown.add(key);
      else shown.delete(key);
      axes.forEach((a, i) => [1, 2].forEach((j) => u.setSeries(2 * i + j, { show: shown.has(a.name) })));
    }));
    host.append(element('p', { class: 'note' },
      'Root of the one-sided power spectral density over frequency [Hz] (Welch 1967); dashed: what the fit makes. '
      + 'Its flat part is √2 N, the noise density of datasheets.'));
    tell();
    return { units(next) { system = next; tell(); u.setData(columns()); } };
  }

  function hatch(context, from, to, top, height, ink) {
    const ratio = devicePixelRatio;
    context.save();
    context.beginPath();
    context.rect(from, top, Math.max(to - from, ratio), height);
    context.clip();
    context.strokeStyle = ink;
    context.lineWidth = ratio;
    for (let x = from - height; x < to; x += 7 * ratio) {
      context.beginPath();
      context.moveTo(x, top + height);
      context.lineTo(x + height, top);
      context.stroke();
    }
    context.restore();
  }

  function signal(host, sensor, units) {
    const { time, axes, leftOut, gaps, starts } = sensor.signal;
    let system = units;
    const long = time[time.length - 1] > 7200;
    const [scale, name] = long ? [3600, 'h'] : [60, 'min'];
    const hours = time.map((t) => t / scale);
    const outside = (t) => leftOut.some(([from, to]) => t >= from && t <= to);
    const made = [];
    host.append(element('h3', {}, 'Raw signal'));
    for (const a of axes) {
      const label = a.name.split('_').pop();
      const unit = () => sensor.units[system].signal;
      const columns = () => [hours, a.low, a.high].map((c, i) => (i ? c.map((v) => (v === null ? null : v * unit()[1])) : c));
      // The evidence fills the picture; a knock that was left out may leave it.
      const counted = time.map((t, i) => (outside(t) ? [] : [a.low[i], a.high[i]])).flat().filter((v) => v !== null);
      const reach = counted.reduce((most, v) => Math.max(most, Math.abs(v)), 0) || 1;
      const heading = element('p', { class: 'row' });
      const tell = () => { heading.textContent = `${label} about ${number(a.middle * unit()[1])} ${unit()[0]}`; };
      host.append(heading);
      const u = Chart.create(host, {
        label: `Raw signal of ${a.name}`,
        height: 118,
        sync: `signal-${sensor.sensor}`,
        padding: [4, 14, 0, 0],
        x: { axis: { size: 26 } },
        y: { range: () => [-1.15 * reach * unit()[1], 1.15 * reach * unit()[1]], axis: { space: 24, values: (chart, s) => s.map((v) => number(v, 3).replace(/(\.\d*?)0+$/, '$1').replace(/\.$/, '')) } },
        series: [
          { label: 'low', stroke: () => colour(label), width: 0.6, points: { show: false } },
          { label: 'high', stroke: () => colour(label), width: 0.6, points: { show: false } },
        ],
        bands: [{ series: [2, 1], fill: () => colour(label) }],
        below(chart) {
          const { ctx, bbox } = chart;
          const at = (t) => Math.min(Math.max(chart.valToPos(t / scale, 'x', true), bbox.left), bbox.left + bbox.width);
          for (const [from, to] of gaps) {
            ctx.fillStyle = colour('gap');
            ctx.fillRect(at(from), bbox.top, Math.max(at(to) - at(from), devicePixelRatio), bbox.height);
          }
          ctx.fillStyle = colour('ink-2');
          for (const start of starts.slice(1)) ctx.fillRect(at(start), bbox.top, devicePixelRatio, bbox.height);
        },
        above(chart) {
          const { ctx, bbox } = chart;
          const at = (t) => Math.min(Math.max(chart.valToPos(t / scale, 'x', true), bbox.left), bbox.left + bbox.width);
          for (const [from, to] of leftOut) hatch(ctx, at(from), at(to), bbox.top, bbox.height, colour('left-out'));
        },
        describe(chart, i) {
          const [what, factor] = unit();
          const why = outside(time[i]) ? [['left out of the evidence', null]] : [];
          return [[`${number(hours[i])} ${name}`, null], [`${label}  ${number(a.low[i] * factor, 3)}..${number(a.high[i] * factor, 3)} ${what}`, colour(label)], ...why];
        },
      }, columns());
      tell();
      made.push((next) => { system = next; tell(); u.setData(columns()); });
    }
    const said = [`Lowest and highest sample of each short span, over time [${name}].`];
    if (leftOut.length) said.push('Hatched: left out of the evidence (motion, warm-up or a stuck value).');
    if (gaps.length) said.push('Grey: no samples.');
    if (starts.length > 1) said.push('Upright lines: the next recording begins.');
    host.append(element('p', { class: 'note' }, said.join(' ')));
    return { units(next) { made.forEach((update) => update(next)); } };
  }

  return { spectrum, signal };
})();
